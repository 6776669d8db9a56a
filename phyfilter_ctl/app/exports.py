"""Designs handed over: Python text, TOML, FMUs, C. Files are made in a private temporary folder and leave as bytes."""

from __future__ import annotations

import base64
import io
import re
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Literal

from .. import filterfile
from ..codegen import CompilerError, export_c, find_compiler
from ..filter import FilterBank, PhyFilter, SampledPhyFilter
from .checking import MessageError
from .designs import Design

__all__ = ["abilities", "export", "opened", "python_text", "saved"]

Kind = Literal["fmu2", "fmu3", "c"]

_NAME = re.compile(r"[^A-Za-z0-9_.-]+")
_LONGEST_NAME = 60
_LONG_LINE = 70
_SAME_DAY = (1980, 1, 1, 0, 0, 0)  # the archive of one design is the same to the byte


def abilities() -> dict[str, object]:
    """What this machine can export: "fmu", "c", and why not.

    Returns
    -------
    dict
    """
    try:
        find_compiler()
    except CompilerError as error:
        return {"fmu": False, "c": True, "why": f"FMUs need a C compiler: {_line(str(error))}"}
    return {"fmu": True, "c": True, "why": ""}


def python_text(design: Design) -> str:
    """Code that builds the same filter, to the bit.

    Parameters
    ----------
    design : Design

    Returns
    -------
    str
        Lines that leave ``filter``, and ``sampled`` where the sampled filter is stable.
    """
    numbers = [_number(p) for p in design.poles]
    poles = f"[{', '.join(numbers)}]"
    if len(poles) > _LONG_LINE:
        poles = "[\n" + "".join(f"    {number},\n" for number in numbers) + "]"
    if design.numerator.kind == "type":
        made = f"pf.place_poles({poles}, numerator={design.numerator.type})"
    elif design.numerator.kind == "lowpass":
        made = f"pf.PhyFilter.from_poles({poles})"
    else:
        made = f"pf.PhyFilter.from_poles({poles}, b={design.filter.b.tolist()!r})"
    lines = ["import phyfilter_ctl as pf", "", f"filter = {made}"]
    try:
        method = design.sampled.sampling.method
    except ValueError as error:
        lines.append(f"# {_line(str(error))}")
    else:
        lines.append(f"sampled = filter.sampled({design.dt!r}, method={method!r})")
    return "\n".join(lines) + "\n"


def saved(design: Design, name: str) -> dict[str, object]:
    """The reply to op "save": the TOML file of :func:`phyfilter_ctl.save`, the sampling with it where it is stable.

    Parameters
    ----------
    design : Design
    name : str
        Asked for; anything but letters, digits, "_", "-" and "." is left out of it.

    Returns
    -------
    dict
        name, mime, base64.
    """
    system: PhyFilter | SampledPhyFilter = design.filter
    with suppress(ValueError):  # forward Euler that diverges: the filter alone
        system = design.sampled
    with _private_folder() as folder:
        path = Path(folder, "filter.toml")
        filterfile.save(path, system)
        return _download(f"{_plain(name, '.toml')}.toml", "application/toml", path.read_bytes())


def opened(text: str, like: Design) -> tuple[Design, list[str]]:
    """The design in the text of a filter file, and what of the file it does not hold.

    Parameters
    ----------
    text : str
        TOML, as :func:`phyfilter_ctl.save` writes it.
    like : Design
        Gives assumptions, and the sampling where the file has none.

    Raises
    ------
    MessageError
        If it is no filter file, or its filter is of another size than a designer shows.
    """
    with _private_folder() as folder:
        path = Path(folder, "filter.toml")
        path.write_text(text, encoding="utf-8", newline="")
        try:
            system = filterfile.load(path)
            dropped = _dropped(system)
            return like.with_filter(system), dropped
        except (TypeError, ValueError, OverflowError) as error:
            raise MessageError(
                "text", _line(str(error).replace(f"{path}: ", "").replace(str(path), "it"))
            ) from error


def export(design: Design, kind: Kind, channels: int) -> dict[str, object]:
    """The reply to op "export".

    Parameters
    ----------
    design : Design
        As it runs: sampled.
    kind : {"fmu2", "fmu3", "c"}
        An FMU for this machine, or C99 sources in a zip.
    channels : int
        Number n_x of channels of x.

    Returns
    -------
    dict
        name, mime, base64.

    Raises
    ------
    MessageError
        If there is no C compiler for an FMU.
    ValueError
        If the sampled filter is unstable.
    """
    sampled = design.sampled
    with _private_folder() as folder:
        if kind == "c":
            written = export_c(sampled, Path(folder, "phyfilter"), channels=channels)
            return _download("phyfilter_c.zip", "application/zip", _zipped(written))
        from ..fmi import export_fmu

        can = abilities()
        if not can["fmu"]:
            raise MessageError("kind", str(can["why"]))
        path = Path(folder, "phyfilter.fmu")
        try:
            export_fmu(sampled, path, fmi="2.0" if kind == "fmu2" else "3.0", channels=channels)
        except CompilerError as error:
            raise MessageError("kind", f"the FMU could not be built: {_line(str(error))}") from error
        return _download("phyfilter.fmu", "application/octet-stream", path.read_bytes())


# -- inside -----------------------------------------------------------------------------------------------------


def _dropped(system: PhyFilter | FilterBank | SampledPhyFilter) -> list[str]:
    if not isinstance(system, SampledPhyFilter):
        return []
    changed = [name for name in system.sampling.unusual if name != "method"]
    changed += [] if system.E is None else ["E"]
    if not changed:
        return []
    return [f"The file also sets {', '.join(changed)}, which this page does not show and does not keep."]


def _private_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="phyfilter_", ignore_cleanup_errors=True)


def _download(name: str, mime: str, data: bytes) -> dict[str, object]:
    return {"name": name, "mime": mime, "base64": base64.b64encode(data).decode("ascii")}


def _zipped(folder: Path) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        for path in sorted(folder.iterdir()):
            entry = zipfile.ZipInfo(f"phyfilter/{path.name}", date_time=_SAME_DAY)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, path.read_bytes())
    return held.getvalue()


def _plain(name: str, suffix: str) -> str:
    last = PurePosixPath(name.replace("\\", "/")).name.removesuffix(suffix)
    return _NAME.sub("_", last).strip("._-")[:_LONGEST_NAME] or "filter"


def _number(value: complex) -> str:
    return repr(value.real) if value.imag == 0.0 else f"complex({value.real!r}, {value.imag!r})"


def _line(text: str) -> str:
    """One line, without the folder it may name."""
    return " ".join(text.replace(tempfile.gettempdir(), "").split())
