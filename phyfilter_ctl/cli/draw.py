"""``phyfilter-ctl draw``: the block diagram of a filter, a model, an FMU, a package or a function's diagram."""

from __future__ import annotations

import argparse
import importlib
import inspect
import sys
from pathlib import Path
from typing import Any

from .. import models
from .._output import add_json, check_target, write_json, write_text

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """Draw a block diagram as control textbooks do: of a filter file (in the loop of its equation), a model
of "phyfilter-ctl run", an FMU (its ports), a system structure package, or a diagram that a Python function returns. The
function is named as MODULE:FUNCTION, is found from here, and is called without arguments."""

_EPILOG = """examples:
  phyfilter-ctl draw filter.toml -o filter.svg
  phyfilter-ctl draw drone --depth 1 -o drone.svg              a model, each of its diagrams opened in a frame
  phyfilter-ctl draw package.ssp -o package.pdf
  phyfilter-ctl draw servo:build -o servo.png                  what build() of servo.py returns
  phyfilter-ctl draw servo:build --json -                      names of its signals, as margins takes them"""

_SUFFIXES = (".svg", ".png", ".pdf")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl draw``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "what",
        metavar="WHAT",
        help="a filter (.toml), an FMU, a package (.ssp), MODULE:FUNCTION, or a model: "
        f"{', '.join(models.available())}",
    )
    parser.add_argument(
        "--depth", type=int, default=0, metavar="N", help="open diagrams inside, N levels deep (default 0)"
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="FILE",
        help=f"picture to write: {', '.join(_SUFFIXES)}; - for SVG on standard output",
    )
    add_json(parser)


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl draw``; return the exit status.

    Raises
    ------
    ValueError, TypeError, OSError
        If there is nothing of that name, it cannot be drawn, or the picture cannot be written.
    """
    if options.out is None and options.json is None:
        raise ValueError("expected -o FILE for the picture, or --json for the names of its signals")
    if options.depth < 0:
        raise ValueError(f"--depth: expected 0 or more, got {options.depth}")
    if options.out != "-":
        check_target(options.out, suffixes=_SUFFIXES)
    elif options.json == "-":
        raise ValueError("-o - and --json -: one of them can have standard output")
    from ..drawing import draw

    drawing = draw(_named(options.what), depth=options.depth)
    if options.out == "-":
        write_text("-", drawing.svg)
    elif options.out is not None:
        drawing.save(options.out)
    if options.json is not None:
        written = None if options.out in (None, "-") else options.out
        size = {"width": drawing.width, "height": drawing.height}
        write_json(options.json, {"picture": written, **size, "signals": list(drawing.signals)})
    if "-" not in (options.out, options.json):
        print(f"{drawing.width:.0f} x {drawing.height:.0f} px; signals: {', '.join(drawing.signals)}")
    return 0


def _named(what: str) -> Any:
    """What a word of the command line stands for: something that ``draw`` takes."""
    if Path(what).is_file():
        if Path(what).suffix.lower() in (".fmu", ".ssp"):
            return Path(what)
        from .. import filterfile

        return filterfile.load(what)
    if what in models.available():
        return models.load(what).build()
    module, colon, name = what.partition(":")
    if not colon or not all(part.isidentifier() for part in (*module.split("."), *name.split("."))):
        raise ValueError(
            f"{what}: neither a file, nor MODULE:FUNCTION such as servo:build, nor a model; models are "
            f"{', '.join(models.available())}"
        )
    return _built(module, name)


def _built(module: str, name: str) -> Any:
    """What a function of a module returns, or what stands there under that name."""
    import control as ct

    sys.path.insert(0, str(Path.cwd()))
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except ImportError as error:
        raise ValueError(f"{module}: cannot be imported: {error}") from error
    except AttributeError as error:
        raise ValueError(f"{module}:{name}: there is no such function: {error}") from error
    finally:
        sys.path.remove(str(Path.cwd()))
    if isinstance(found, ct.InputOutputSystem) or not callable(found):
        return found
    try:
        inspect.signature(found).bind()
    except TypeError as error:
        raise ValueError(
            f"{module}:{name}: expected a function that needs no arguments ({error}); write one that calls it"
        ) from error
    return found()
