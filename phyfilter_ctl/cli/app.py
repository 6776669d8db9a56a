"""``phyfilter-ctl app``: the designer as a page on this machine."""

from __future__ import annotations

import argparse
from pathlib import Path

from .. import filterfile
from ..recording import Recording

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """Open the designer in the browser: drag poles and zeros, see responses, bounds and margins, try the
filter on a recording, learn one from it, export it. Nothing leaves the machine: the page is served on 127.0.0.1,
answers only to the address that is printed, and loads nothing from elsewhere. Ctrl-C ends it."""

_EPILOG = """examples:
  phyfilter-ctl app                                     start from a double pole at -20 rad/s
  phyfilter-ctl app filter.toml --log flight.csv        start from a filter and a recording
  phyfilter-ctl app session.json                        go on with a session that was saved
  phyfilter-ctl app --no-browser --port 8765            print the address only, at a port of your choice
  phyfilter-ctl app --out exported                      keep a copy of every download in that folder"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl app``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "file", metavar="FILE", nargs="?", help="a filter (.toml) or a session (.json) to start from"
    )
    parser.add_argument("--log", metavar="FILE.csv", help="a recording to start with")
    parser.add_argument(
        "--x", default="vx,vy,vz", metavar="C,C,...", help="its columns of x (default vx,vy,vz)"
    )
    parser.add_argument(
        "--port", type=int, default=0, metavar="N", help="port on 127.0.0.1 (default: a free one)"
    )
    parser.add_argument("--out", metavar="DIR", help="an existing folder for a copy of every download")
    parser.add_argument("--no-browser", action="store_true", help="print the address, open nothing")


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl app`` until Ctrl-C; return the exit status.

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
    from ..app import Session
    from ..app.sessions import load_session

    if not 0 <= options.port <= 65535:
        raise ValueError(f"--port: expected 0 to 65535, got {options.port}")
    out = Path(options.out) if options.out is not None else None
    if out is not None and not out.is_dir():
        raise ValueError(f"--out: there is no folder {options.out}")
    file: str = options.file or ""
    is_session = file.lower().endswith(".json")
    session = Session(
        filterfile.load(file) if file and not is_session else None,
        kept=load_session(file) if is_session else None,
        log=Recording.from_csv(options.log, x=options.x.split(",")) if options.log is not None else None,
    )
    serve(session, port=options.port, out=out, browser=not options.no_browser)
    return 0
