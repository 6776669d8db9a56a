"""Damaged FMUs and packages are read or refused in words that name the file; more of them by ``python -m tests.fuzz``.

Bytes of the archive are damaged as those of logs are; in documents whose checksums are right, values of attributes are
exchanged for such as no tool writes, and elements are dropped, doubled and moved.
"""

from __future__ import annotations

import io
import re
import tempfile
import time
import zipfile
from functools import cache
from pathlib import Path

import control as ct
import numpy as np
import pytest
from foreign_fmus import description
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl.fmi import describe, export_ssp, read_ssp
from tests.logfiles.mutations import mutated

_LONGEST = 20.0  # s of a processor that an example may take; an honest one takes milliseconds
_VALUES = [
    "",
    "-1",
    "0",
    "nan",
    "INF",
    "1e999",
    "9" * 40,
    "../../x",
    "true",
    "a b",
    "\u00e9",
    "x" * 5000,
    "#1",
]


@cache
def sound(kind: str) -> bytes:
    """A small archive."""
    if kind != "ssp":
        held = io.BytesIO()
        with zipfile.ZipFile(held, "w") as archive:
            archive.writestr("modelDescription.xml", description(kind))
        return held.getvalue()
    plant = ct.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], inputs=["u", "w"], outputs="y", name="plant")
    filter = ct.ss(-2.0, 1.0, 1.0, 0.0, inputs="y", outputs="u", name="filter")
    loop = ct.interconnect([plant, filter], inputs=["w"], outputs=["y"], name="loop")
    with tempfile.TemporaryDirectory() as folder:
        return export_ssp(loop, Path(folder, "loop.ssp"), platforms=(), stop_time=1.0).read_bytes()


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """The archive with other bytes, or with other documents inside."""
    if rng.integers(3) == 0:
        return mutated(data, rng)
    held = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(held, "w", zipfile.ZIP_DEFLATED) as new:
        documents = [name for name in old.namelist() if name.endswith((".xml", ".ssd", ".ssv", ".fmu"))]
        chosen = documents[int(rng.integers(len(documents)))]
        for name in old.namelist():
            content = old.read(name)
            if name == chosen:
                content = damaged(content, rng) if name.endswith(".fmu") else rewritten(content.decode(), rng)
            new.writestr(name, content)
    return held.getvalue()


def rewritten(text: str, rng: np.random.Generator) -> bytes:
    """A document with a few other values and elements."""
    for _ in range(int(rng.integers(1, 4))):
        values = list(re.finditer(r'="([^"]*)"', text))
        tags = list(re.finditer(r"<[^>?]*/>", text))
        if not values or not tags:
            break
        value, tag, other = (each[int(rng.integers(len(each)))] for each in (values, tags, tags))
        match int(rng.integers(5)):
            case 0:
                new = _VALUES[int(rng.integers(len(_VALUES)))]
                text = f"{text[: value.start(1)]}{new}{text[value.end(1) :]}"
            case 1:
                new = values[int(rng.integers(len(values)))][1]
                text = f"{text[: value.start(1)]}{new}{text[value.end(1) :]}"
            case 2:
                text = text[: tag.start()] + text[tag.end() :]
            case 3:
                text = text[: tag.start()] + other[0] + text[tag.start() :]
            case _:
                name = value.start() - len(re.search(r"\s[\w:]*$", text[: value.start()])[0])  # type: ignore[index]
                text = text[:name] + text[value.end() :]
    return text.encode()


def outcome(path: Path) -> str:
    """What comes of reading the archive; another error than a refusal is raised."""
    before, began = sorted(path.parent.iterdir()), time.process_time()
    try:
        if path.suffix == ".ssp":
            read_ssp(path)
        else:
            str(describe(path))
        found = "read"
    except (ValueError, OSError) as error:
        found = "refused"
        if str(path) not in str(error):
            raise AssertionError("the file is not named") from error
    assert time.process_time() - began < _LONGEST
    assert sorted(path.parent.iterdir()) == before
    return found


@pytest.mark.parametrize("kind", ["2.0", "3.0", "ssp"])
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_archives_are_read_or_refused(kind: str, seed: int) -> None:
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        temporary = Path(folder, "temporary")
        temporary.mkdir()
        patch.setattr(tempfile, "tempdir", str(temporary))
        path = Path(folder, "a.ssp" if kind == "ssp" else "a.fmu")
        path.write_bytes(damaged(sound(kind), np.random.default_rng(seed)))
        outcome(path)
        assert not list(temporary.iterdir()), "what was unpacked is left"


@pytest.mark.parametrize("kind", ["2.0", "3.0", "ssp"])
def test_the_sound_archive_is_read(kind: str, tmp_path: Path) -> None:
    path = tmp_path / ("a.ssp" if kind == "ssp" else "a.fmu")
    path.write_bytes(sound(kind))
    assert outcome(path) == "read"
