"""Filter files and logs that nobody meant: each is read, or refused in words that name it; never another exception."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter, Recording, load, lowpass, save
from phyfilter_ctl.filter import SampledPhyFilter, Sampling

NUMBERS = [
    "0",
    "-1",
    "1e308",
    "-1e308",
    "5e-324",
    "1e999",
    "nan",
    "inf",
    "1" * 400,
    "1_0",
    "0x1F",
    ".",
    "true",
    "2e2",
]
STRANGE = [
    "",
    '"',
    "'",
    ",",
    "\n",
    "\r",
    "\t",
    "\x00",
    "\ufeff",
    "é",
    "#",
    "=",
    "[",
    "]",
    "[[a]]\n",
    "{}",
    "a.b",
    "[" * 500,
]


def words(text: str) -> list[str]:
    return re.findall(r"[\w.+-]+|[^\w.+-]", text)


def lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


@st.composite
def mutated(draw: st.DrawFn, wholes: list[str]) -> bytes:
    """A sound text in which words, lines and bytes were changed, taken out, doubled or mixed with those of others."""
    whole = draw(st.sampled_from(wholes))
    for _ in range(draw(st.integers(1, 4))):
        cut = draw(st.sampled_from([words, lines]))
        pieces, spare = (
            cut(whole),
            [*NUMBERS, *STRANGE, *sorted({piece for text in wholes for piece in cut(text)})],
        )
        first = draw(st.integers(0, len(pieces)))
        last = first + draw(st.integers(0, 2))
        whole = "".join(
            [*pieces[:first], *draw(st.lists(st.sampled_from(spare), max_size=2)), *pieces[last:]]
        )
    data = bytearray(whole.encode())
    if data and draw(st.booleans()):
        data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
    return bytes(data)


@pytest.fixture(scope="module")
def filter_texts(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    path = tmp_path_factory.mktemp("filters") / "f.toml"
    two = SampledPhyFilter([lowpass(2, 20.0), PhyFilter([20.0], [5.0])], Sampling(0.002, limit=[1.0, 2.0]))
    known = {"channels": ["vx", "vy"], "units": {"x": "m/s"}, "inertia": [[2.0, 0.1], [0.1, 3.0]]}
    two = replace(two, sampling=two.sampling.told(**known))
    texts = []
    for system in (lowpass(3, 20.0), two, lowpass(2, 9.0).sampled(0.01)):
        save(path, system)
        texts.append(path.read_text())
    return texts


def refusal(read: Callable[[Path], object], path: Path) -> str | None:
    """Why a file is refused; None where it is read."""
    try:
        read(path)
    except ValueError as error:
        return str(error)
    return None


@given(data=st.data())
def test_mutated_filter_files(filter_texts, tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "mutated.toml"
    path.write_bytes(data.draw(mutated(filter_texts)))
    said = refusal(load, path)
    assert said is None or said.startswith(str(path))


@pytest.fixture(scope="module")
def log_texts(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    x = np.arange(12.0).reshape(4, 3)
    whole = Recording.from_arrays(
        x=x, dt=0.1, channels=["vx", "vy", "vz"], label=x, g=-x, features=x, inertia=np.eye(3)
    )
    texts = []
    for log in (whole, Recording.from_arrays(x=x, dt=0.1, channels=["vx", "vy", "vz"], f_theta=x)):
        log.to_csv(path)
        texts += [path.read_text(), "# comment\n\n" + path.read_text()]
    return texts


@given(data=st.data())
def test_mutated_logs(log_texts, tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "mutated.csv"
    path.write_bytes(data.draw(mutated(log_texts)))
    said = refusal(Recording.from_csv, path)
    assert said is None or said.startswith(str(path))
