"""Designs handed over: TOML, FMUs, C, packages for targets. Files are made in a private temporary folder and leave as
bytes, under a name that tells one design from another.
"""

from __future__ import annotations

import base64
import hashlib
import io
import re
import tempfile
import zipfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import cast, get_args

import numpy as np

from .. import filterfile
from ..codegen import CompilerError, export_c, export_target, find_compiler
from ..codegen.export_target import Target
from ..codegen.identifiers import model_identifier
from ..codegen.target_autopilots import check_autopilot
from ..filter import FilterBank, PhyFilter, SampledPhyFilter, Sampling
from ..filter.sampling import InertiaInput, SamplingOptions
from ..recording import Recording
from ..recording.checks import inertia_varies
from .checking import MessageError
from .designs import Design, Signals
from .python_text import family_of

__all__ = ["KINDS", "abilities", "channels_of", "exchange", "export", "opened", "saved", "titled", "with_log"]

_TARGETS: tuple[Target, ...] = get_args(Target)
KINDS: tuple[str, ...] = ("fmu2", "fmu3", "c", *_TARGETS)
_NAME = re.compile(r"[^A-Za-z0-9_.-]+")
_WORD = re.compile(r"[a-z][a-z0-9]*")
_LONGEST_NAME, _LONGEST_SYMBOL = 60, 30
_MIMES = {".toml": "application/toml", ".zip": "application/zip"}
_DIGEST = 8  # hexadecimal digits
# Of the modules for vehicles: one low-pass filter on three axes.
_VEHICLES = ("ardupilot", "crazyflie", "px4", "ros2")
_AXES = 3
_OPERATING_SYSTEM_TICKS = 1000  # a Crazyflie's, in Hz
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


def exchange(design: Design, channels: int) -> dict[str, object]:
    """The reply to op "exports": what this design can leave as, and what stands against it.

    Parameters
    ----------
    design : Design
    channels : int
        Number n_x of channels of x.

    Returns
    -------
    dict
        name, as files have it; exports, a list of kind, able and why; channels.
    """
    can = abilities()
    found: list[dict[str, object]] = []
    for kind in KINDS:
        why = "" if kind not in ("fmu2", "fmu3") or can["fmu"] else str(can["why"])
        why = why or _refusal(design, kind, channels)
        found.append({"kind": kind, "able": not why, "why": why})
    return {"name": _title(design, ""), "exports": found, "channels": channels}


def titled(design: Design, name: str, *told: object) -> tuple[str, str]:
    """The name of a design's files, and a digest that no other design has.

    Parameters
    ----------
    design : Design
    name : str
        Asked for; empty: after the design.
    told : object
        What the file depends on besides.

    Returns
    -------
    title, digest : str
    """
    return _title(design, name), _digest(design, *told)


def with_log(design: Design, log: Recording | None, channels: int | None) -> Design:
    """The design with the channels, inertia and unit of the open log where it has none of its own.

    An inertia that changes during the log comes with every sample of what is exported.

    Parameters
    ----------
    design : Design
    log : Recording or None
    channels : int, optional
        Asked for.

    Raises
    ------
    MessageError
        If the channels that are asked for contradict those of the design, or the inertia of the log.
    """
    own = Sampling(1.0, **design.signals.options)
    n_x = own.n_x if design.signals.E is None else len(design.signals.E)
    if channels is not None and n_x not in (None, channels):
        raise MessageError("channels", f"the design is for {n_x} channels, got {channels}")
    if log is None or n_x not in (None, log.n_x):
        return design
    options: SamplingOptions = {}
    if own.channels is None and channels in (None, log.n_x):
        options["channels"] = list(log.channels)
    if own.inertia is None and log.inertia is not None:
        options["inertia"] = _inertia(log)
        if np.ndim(log.inertia) and channels not in (None, log.n_x):
            raise MessageError(
                "channels", f"the log has an inertia for each of its {log.n_x} channels, got {channels}"
            )
    if not own.units.get("x") and log.unit:
        options["units"] = {**own.units, "x": log.unit}
    merged: SamplingOptions = {**design.signals.options, **options}
    return replace(design, signals=replace(design.signals, options=merged))


def channels_of(design: Design, channels: int | None) -> int:
    """Number of channels of what is exported: those asked for, those of the design, or 1.

    Parameters
    ----------
    design : Design
        As :func:`with_log` gives it.
    channels : int, optional
        Asked for.
    """
    E, known = design.signals.E, Sampling(1.0, **design.signals.options).n_x
    return channels or known or (1 if E is None else len(E))


def _inertia(log: Recording) -> float | list[float] | list[list[float]] | InertiaInput:
    M = log.inertia
    assert M is not None
    if inertia_varies(M, log.n):
        if np.any(M[0] != M):
            return "diagonal" if M.ndim == 2 else "full"
        M = M[0]
    return M.tolist()


def _states(design: Design) -> list[str]:
    """What a file that leaves says of its signals."""
    sampling = Sampling(1.0, **design.signals.options)
    M = sampling.inertia
    said = (
        "M_hat = 1"
        if M is None
        else "M_hat with every sample"
        if isinstance(M, str)
        else f"M_hat = {M.tolist()}"
    )
    parts = [said, ", ".join(sampling.names), *(f"{name} in {unit}" for name, unit in sampling.units.items())]
    parts += [] if design.signals.E is None else [f"E = {design.signals.E}"]
    return [f"It has {'; '.join(filter(None, parts))}."]


def saved(design: Design, name: str) -> dict[str, object]:
    """The reply to op "save": the TOML file of :func:`phyfilter_ctl.save`, the sampling with it where it is stable.

    Parameters
    ----------
    design : Design
    name : str
        Asked for; anything but letters, digits, "_", "-" and "." is left out of it. Empty: after the design.

    Returns
    -------
    dict
        name, digest, mime, base64; messages, what the file says of inertia, channels and units.
    """
    system: PhyFilter | SampledPhyFilter = design.filter
    with suppress(ValueError):  # forward Euler that diverges: the filter alone
        system = design.handed_over
    with _private_folder() as folder:
        path = Path(folder, "filter.toml")
        filterfile.save(path, system)
        title, digest = _title(design, name.removesuffix(".toml")), _digest(design)
        return _download(f"{title}-{digest}.toml", digest, path.read_bytes()) | {"messages": _states(design)}


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


def export(design: Design, kind: str, channels: int, name: str = "") -> dict[str, object]:
    """The reply to op "export".

    Parameters
    ----------
    design : Design
        As it runs: sampled.
    kind : str
        One of ``KINDS``: an FMU for this machine, C99 sources or the package of a target in a zip.
    channels : int
        Number n_x of channels of x.
    name : str
        Of the files and, as far as C takes it, of what is in them. Empty: after the design.

    Returns
    -------
    dict
        name, digest, mime, base64, messages as :func:`saved`.

    Raises
    ------
    MessageError
        If there is no C compiler for an FMU, or the target cannot take the design.
    ValueError
        If the sampled filter is unstable.
    """
    sampled = design.handed_over
    symbol = _symbol(name)
    title, digest = _title(design, name), _digest(design, channels, symbol)
    with _private_folder() as folder:
        if kind in ("fmu2", "fmu3"):
            data = _fmu(sampled, kind, channels, symbol, Path(folder, f"{symbol}.fmu"))
            reply = _download(f"{title}-{digest}-fmi{kind[-1]}.fmu", digest, data)
            return reply | {"messages": _states(design)}
        if why := _refusal(design, kind, channels):
            raise MessageError("kind", why)
        place = Path(folder, symbol)
        if kind == "c":
            export_c(sampled, place, channels=channels, name=symbol)
        else:
            export_target(sampled, cast(Target, kind), place, channels=channels, name=symbol)
        reply = _download(f"{title}-{digest}-{kind}.zip", digest, _zipped(place))
        return reply | {"messages": _states(design)}


# -- inside -----------------------------------------------------------------------------------------------------


def _fmu(sampled: SampledPhyFilter, kind: str, channels: int, symbol: str, path: Path) -> bytes:
    from ..fmi import export_fmu

    can = abilities()
    if not can["fmu"]:
        raise MessageError("kind", str(can["why"]))
    whole = replace(sampled, sampling=sampled.sampling.told(channels=channels))
    try:
        export_fmu(whole, path, fmi="2.0" if kind == "fmu2" else "3.0", name=symbol)
    except CompilerError as error:
        raise MessageError("kind", f"the FMU could not be built: {_line(str(error))}") from error
    return path.read_bytes()


def _refusal(design: Design, kind: str, channels: int) -> str:
    """Why a kind cannot take this design; empty where it can."""
    try:
        sampled = design.handed_over
    except ValueError as error:
        return _line(str(error))
    if kind not in _VEHICLES:
        return ""
    if channels != _AXES:
        return f"This module works on the three axes of a vehicle: set {_AXES} channels."
    if not design.filter.is_lowpass:
        return "The poles become parameters of the vehicle, so N must be a₀ alone: choose the low-pass numerator."
    try:
        check_autopilot(kind, sampled, "phyfilter", channels, sampled.sampling.inertia)
    except ValueError as error:
        if kind == "crazyflie" and "rate" in str(error):
            return (
                f"The rate must divide {_OPERATING_SYSTEM_TICKS} Hz: choose a step of 1, 2, 4, 5, 8 or 10 ms."
            )
        return _line(str(error)).removeprefix(f"{kind}: ").capitalize() + "."
    return ""


def _title(design: Design, name: str) -> str:
    """The name asked for, as files can have it, or the design's own."""
    if title := _plain(name):
        return title
    named = family_of(design.filter)
    return f"filter_{design.filter.order}" if named is None else _plain(named.title)


def _digest(design: Design, *given: object) -> str:
    """What no other design's files have in their names."""
    told = (design.filter.a.tolist(), design.filter.b.tolist(), design.dt, design.method, *given)
    told += tuple(design.signals.as_json().items())
    return hashlib.sha256(repr(told).encode()).hexdigest()[:_DIGEST]


def _symbol(name: str) -> str:
    """A name that C, file systems and autopilots take: small letters and digits, words joined by "_"."""
    words = "_".join(_WORD.findall(_plain(name).lower()))[:_LONGEST_SYMBOL].rstrip("_")
    return model_identifier(words) if words else "phyfilter"


def _dropped(system: PhyFilter | FilterBank | SampledPhyFilter) -> list[str]:
    if not isinstance(system, SampledPhyFilter):
        return []
    kept = {"method", "E", *Signals.of(system).options}
    changed = [name for name in system.sampling.unusual if name not in kept]
    if not changed:
        return []
    return [f"The file also sets {', '.join(changed)}, which this page does not show and does not keep."]


def _private_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="phyfilter_", ignore_cleanup_errors=True)


def _download(name: str, digest: str, data: bytes) -> dict[str, object]:
    mime = _MIMES.get(PurePosixPath(name).suffix, "application/octet-stream")
    return {"name": name, "digest": digest, "mime": mime, "base64": base64.b64encode(data).decode("ascii")}


def _zipped(folder: Path) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            entry = zipfile.ZipInfo(
                f"{folder.name}/{path.relative_to(folder).as_posix()}", date_time=_SAME_DAY
            )
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, path.read_bytes())
    return held.getvalue()


def _plain(name: str) -> str:
    last = PurePosixPath(name.replace("\\", "/")).name
    return _NAME.sub("_", last).strip("._-")[:_LONGEST_NAME].rstrip("._-")


def _line(text: str) -> str:
    """One line, without the folder it may name."""
    return " ".join(text.replace(tempfile.gettempdir(), "").split())
