"""``phyfilter-ctl app``: the designer as a page on this machine."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from .._choices import TimeUnit
from .columns import names_of

if TYPE_CHECKING:
    from ..recording import Recording

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """Open the designer in the browser: drag poles and zeros, see responses, bounds and margins, try the
filter on a recording, learn one from it, export it. Nothing leaves the machine: the page is served on 127.0.0.1,
answers only to the address that is printed, and loads nothing from elsewhere. Ctrl-C ends it."""

_EPILOG = """examples:
  phyfilter-ctl app                                     start from a double pole at -20 rad/s
  phyfilter-ctl app filter.toml --log flight.csv        start from a filter and a recording
  phyfilter-ctl app session.json                        go on with a session that was saved
  phyfilter-ctl app --log tunnel.csv --x u --label fx --inertia 1.5 --time-unit us
  phyfilter-ctl app --no-browser --port 8765            print the address only, at a port of your choice
  phyfilter-ctl app --out exported                      keep a copy of every download in that folder"""

_COLUMNS = ("time", "time_unit", "x", "label", "g", "f_theta", "inertia", "unit_x", "unit_f")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl app``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "file", metavar="FILE", nargs="?", help="a filter (.toml) or a session (.json) to start from"
    )
    parser.add_argument(
        "--log",
        metavar="FILE",
        help="a recording of any size; the page asks what its columns are, unless --x or usual names say it",
    )
    parser.add_argument(
        "--port", type=int, default=0, metavar="N", help="port on 127.0.0.1 (default: a free one)"
    )
    parser.add_argument("--out", metavar="DIR", help="an existing folder for a copy of every download")
    parser.add_argument("--no-browser", action="store_true", help="print the address, open nothing")
    columns = parser.add_argument_group("columns of --log, with commas between them")
    columns.add_argument("--time", metavar="COLUMN", help="times (default: the one called so)")
    columns.add_argument(
        "--time-unit", choices=get_args(TimeUnit), help="of the times, where they do not say it"
    )
    columns.add_argument("--x", metavar="C,C,...", help="measured signal")
    columns.add_argument("--label", metavar="C,C,...", help="true f")
    columns.add_argument("--g", metavar="C,C,...", help="known part of M x'")
    columns.add_argument("--f-theta", metavar="C,C,...", help="learned model's estimate of f")
    columns.add_argument("--inertia", metavar="M,... | C,...", help="M: numbers or columns (default 1)")
    for signal in ("x", "f"):
        columns.add_argument(
            f"--unit-{signal}",
            metavar="UNIT",
            help=f"of {signal}, such as {'km/h' if signal == 'x' else 'kN'}, turned into SI (default: as columns say)",
        )


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl app`` until a signal ends it; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options are wrong, a file cannot be read, the port is taken or the extra is not installed.
    """
    try:
        from ..app.server import serve
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("anyio", "starlette", "uvicorn"):
            raise
        raise ValueError(
            f"the designer's page needs {error.name}, which is not installed: pip install 'phyfilter-ctl[app]'"
        ) from error
    from .. import filterfile
    from ..app.handling import Session
    from ..app.sessions import load_session, recording_beside

    if not 0 <= options.port <= 65535:
        raise ValueError(f"--port: expected 0 to 65535, got {options.port}")
    out = Path(options.out) if options.out is not None else None
    if out is not None and not out.is_dir():
        raise ValueError(f"--out: there is no folder {options.out}")
    file: str = options.file or ""
    kept = load_session(file) if file.lower().endswith(".json") else None
    log, messages = _log(options)
    if kept is not None and options.log is None:
        log, messages = recording_beside(kept, Path(file).parent)
    session = Session(
        filterfile.load(file) if file and kept is None else None,
        kept=kept,
        log=log,
        waiting=Path(options.log) if options.log is not None and log is None else None,
    )
    print("".join(f"{options.log or file}: {message}\n" for message in messages), end="")
    serve(session, port=options.port, out=out, browser=not options.no_browser)
    return 0


def _log(options: argparse.Namespace) -> tuple[Recording | None, list[str]]:
    """The recording, where its columns are named or are those of this project; else None: the page asks then."""
    from ..app.imports import Roles, import_log, usual_roles
    from ..app.inbox import Source

    given = [name for name in _COLUMNS if getattr(options, name) is not None]
    if options.log is None:
        if given:
            raise ValueError(f"--{given[0].replace('_', '-')}: expected --log beside it")
        return None, []
    source = Source(Path(options.log), Path(options.log).name)
    if not given:
        return (None, []) if (roles := usual_roles(source)) is None else import_log(source, roles)
    if options.x is None:
        raise ValueError("--x: expected the columns of the measured signal beside the other columns of --log")
    named = {name: getattr(options, name) for name in ("label", "g", "f_theta")}
    signals = {
        name: tuple(names_of(f"--{name.replace('_', '-')}", text))
        for name, text in named.items()
        if text not in (None, "none")
    }
    inertia = () if options.inertia in (None, "none") else _numbers(names_of("--inertia", options.inertia))
    x = tuple(names_of("--x", options.x))
    units = {"x": options.unit_x, "f": options.unit_f}
    units = {signal: unit for signal, unit in units.items() if unit is not None}
    roles = Roles(x, options.time, options.time_unit, signals, inertia, units)
    return import_log(source, roles)


def _numbers(entries: list[str]) -> tuple[float, ...] | tuple[str, ...]:
    """Numbers where all are, else names of columns."""
    try:
        return tuple(float(entry) for entry in entries)
    except ValueError:
        return tuple(entries)
