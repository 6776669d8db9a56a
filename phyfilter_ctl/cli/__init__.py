"""The command ``phyfilter-ctl``."""

from __future__ import annotations

import argparse
import difflib
import math
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import NoReturn

from .. import __version__, models
from .._output import add_quiet, check_target, noted_writes
from .wording import in_options

__all__ = ["main"]

_EPILOG = """examples:
  phyfilter-ctl run drone                                      fly a drone with unknown mass in unseen wind
  phyfilter-ctl estimate flight.csv                            what force did my model miss, which filter shows it
  phyfilter-ctl app                                            design a filter with the mouse, in the browser
  phyfilter-ctl design --poles -20,-20                         choose a filter and see what it does
  phyfilter-ctl design --family butterworth --order 2 --cutoff 20 --dt 0.002 --out filter.toml
  phyfilter-ctl log flight.ulg                                 what a robot's log holds: topics, units, clocks
  phyfilter-ctl learn flight.csv --order 1 2 3 --out filter.toml
                                                               learn filters from a flight with a known f
  phyfilter-ctl analyze filter.toml --slope 3 --noise 0.01     what it promises: bounds, noise, margins
  phyfilter-ctl export filter.toml --fmu filter.fmu --c firmware --channels 3
                                                               hand it over: FMU, SSP, C
  phyfilter-ctl fmu check model.fmu                            describe, check, run FMUs of any tool
  phyfilter-ctl draw drone --depth 1 -o drone.svg              a block diagram as textbooks draw it
  phyfilter-ctl COMMAND --help                                 all options of a command, with examples

exit status: 0 done; 1 an FMU is wrong, or its run failed (fmu check, fmu run); 2 an argument or an input is wrong;
130 stopped by Ctrl+C, 143 by SIGTERM, 129 by SIGHUP; 141 the reader of the output has closed it"""

# Modules of this room, and what their commands are for; one of two words is in a module such as log_resample.
_COMMANDS = {
    "design": "choose a filter: description, figures, picture, file",
    "log": "what a robot's log holds: topics, units, clocks, gaps",
    "log resample": "a recording at equal steps",
    "log label": "the force of a recording from both sides, as its label",
    "estimate": "the force your model missed in recordings, and the filter that shows it",
    "learn": "learn filters from flights: table, picture, file",
    "analyze": "what a filter promises: bounds, noise, margins",
    "export": "hand a filter or a model over: FMU, SSP, C",
    "fmu": "describe, check and run FMUs of any tool",
    "draw": "the block diagram of a filter, a model, an FMU, a package or your own",
    "app": "design interactively, on a page in the browser",
    "completion": "lines for a shell that complete this command",
}

_RUN_EPILOG = """examples:
  phyfilter-ctl run drone
  phyfilter-ctl run acceleration --help

files to read and to copy are run by Python itself:
  python -m phyfilter_ctl.models.drone.example       # one for each model
  python -m phyfilter_ctl.models.everyday.pendulum   # dc_motor, two_link_arm, differential_drive, vertical_axis"""

# What is nothing without a further word shows its help.
_BARE = ([], ["run"], ["fmu"], ["log"])

# Values that begin with a minus sign would be taken for options.
_SIGNED = ("--poles", "--poles-hz")


# Status of a process that SIGPIPE ended, 128 + 13.
_SIGPIPE = 141


# A shell's `timeout` sends its signal to the process and to its group: what comes within so many s is the same one.
_SAME_SIGNAL = 1.0


class _EndedError(SystemExit):
    """A signal has asked the process to end; its status is that of a shell, 128 + the number."""


class _NobodyReadsError(Exception):
    """The reader of standard output has left, as ``head`` does."""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, and what was meant where something is spelled alike."""

    def error(self, message: str) -> NoReturn:
        if found := re.search(r"(?:invalid choice|unrecognized arguments): '?(-*[\w.-]+)", message):
            near = difflib.get_close_matches(found[1], self._words(found[1].startswith("-")), 1)
            message += f"; did you mean {near[0]}?" if near else ""
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")

    def _words(self, options: bool) -> list[str]:
        """Options of this parser and of those below it, or the values that it chooses between."""
        words: list[str] = []
        for action in self._actions:
            words += action.option_strings if options else map(str, action.choices or ())
            if options and isinstance(action, argparse._SubParsersAction):
                for parser in action.choices.values():
                    words += parser._words(options)
        return words


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments after the name of the command; None means those of the process.

    Returns
    -------
    int
        0; 2 where an argument or an input is wrong, with one line on standard error, or a compiler fails, with
        its words; 141, as a shell says of SIGPIPE, where standard output is a pipe that nobody reads any more;
        130, 143 or 129 where Ctrl-C, SIGTERM or SIGHUP stopped the work.

    Examples
    --------
    >>> main(["design", "--poles", "-20,-20", "--picture", "none"])  # doctest: +ELLIPSIS
    F(s) = 400/(s**2 + 40*s + 400)
    order       2, low-pass form
    ...
    0
    """
    arguments = _with_signed_values(sys.argv[1:] if argv is None else argv)
    if (words := " ".join(arguments[:2])) in _COMMANDS:
        arguments[:2] = [words]
    if arguments in _BARE:
        arguments.append("--help")
    known: Collection[str] = ()
    try:
        with _ending_on_signals(), _flushed_output(), noted_writes() as written:
            options = _parser(arguments).parse_args(arguments)
            known = options.known
            check_target(getattr(options, "json", None))
            status = int(options.job(options))
            if not (options.quiet or options.job.__module__.endswith(".export")):
                _tell(written)
            return status
    except _NobodyReadsError:
        return _SIGPIPE
    except (ValueError, TypeError, OSError) as error:
        text = _one_line(error)
        told = text if isinstance(error, OSError) else in_options(text, known)
        print(f"phyfilter-ctl: error: {told}", file=sys.stderr)
        return 2
    except RuntimeError as error:
        from ..codegen import CompilerError

        if not isinstance(error, CompilerError):
            raise
        print(f"phyfilter-ctl: error: {error}", file=sys.stderr)  # with what the compiler said, line by line
        return 2
    except (KeyboardInterrupt, _EndedError) as end:
        print("phyfilter-ctl: stopped", file=sys.stderr)
        return int(end.code or 1) if isinstance(end, _EndedError) else 130


@contextmanager
def _ending_on_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the work as Ctrl-C does: from within, so that files are tidied and processes ended."""
    last = -math.inf

    def end(number: int, frame: object) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        if last - before > _SAME_SIGNAL:
            raise _EndedError(128 + number)

    # Python lets only the main thread ask for signals; one that is ignored, as under nohup, or taken stays so.
    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    mine = threading.current_thread() is threading.main_thread()
    taken = [number for number in numbers if mine and signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def _flushed_output() -> Iterator[None]:
    """Write what is left of standard output while a failure can still be told; Python's own flush is too late."""
    try:
        yield
    finally:
        try:
            sys.stdout.flush()
        except OSError as error:
            with open(os.devnull, "wb") as nothing:
                os.dup2(nothing.fileno(), sys.stdout.fileno())  # Python will try once more
            if isinstance(error, BrokenPipeError):
                raise _NobodyReadsError from None
            error.filename = error.filename or "standard output"
            raise


def _tell(written: Sequence[Path]) -> None:
    """Say on standard error what was written and is still there; what was made on the way is not."""
    here = Path.cwd()
    names = [
        f"{path.relative_to(here) if path.is_relative_to(here) else path}{os.sep if path.is_dir() else ''}"
        for path in written
        if path.exists()
    ]
    if names:
        sys.stdout.flush()
        print(f"wrote {', '.join(names)}", file=sys.stderr)


def _parser(arguments: Sequence[str] | None) -> argparse.ArgumentParser:
    """The parser with what these arguments need; None: with all that is one word, as a shell completes it."""
    parser = _Parser(
        prog="phyfilter-ctl",
        description="Repair a learned model of robot dynamics with a designed filter of its residual.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"phyfilter-ctl {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, parser_class=_Parser)
    _add_run(commands, arguments)
    for name, text in _COMMANDS.items():
        if arguments is None and " " in name:
            continue
        command = commands.add_parser(name, help=text)
        if arguments is None or name in arguments[:1]:  # only the one asked for is imported
            module = import_module(f".{name.replace(' ', '_')}", __name__)
            module.add_arguments(command)
            command.set_defaults(job=module.main)
            _finish(command)
    return parser


def _finish(parser: argparse.ArgumentParser) -> None:
    """Add ``--quiet`` to a command, to each of its jobs where it has some, unless it is there; note its options."""
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for job in (job for action in below for job in action.choices.values()):
        _finish(job)
    if not below:
        if "--quiet" not in parser._option_string_actions:
            add_quiet(parser)
        parser.set_defaults(known=frozenset(parser._option_string_actions))


def _add_run(commands: argparse._SubParsersAction[_Parser], arguments: Sequence[str] | None) -> None:
    run = commands.add_parser(
        "run",
        help="run one of the models",
        description="Run one of the models.",
        epilog=_RUN_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    names = run.add_subparsers(title="models", metavar="MODEL", required=True, parser_class=_Parser)
    for name in models.available():
        parser = names.add_parser(name, help=models.summary(name))
        if arguments is None or name in arguments[1:2]:
            model = models.load(name)
            model.add_arguments(parser)
            parser.set_defaults(job=model.main)
            _finish(parser)


def describe_commands() -> dict[str, str]:
    """The help of every command, job and model, by name."""
    whole = _parser(None)
    found = {whole.prog: whole.format_help(), **dict(_helps(whole))}
    for words in (name for name in _COMMANDS if " " in name):
        found |= {name: text for name, text in _helps(_parser([words])) if name.endswith(words)}
    return dict(sorted(found.items()))


def _helps(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for job in action.choices.values():
                yield job.prog, job.format_help()
                yield from _helps(job)


def _with_signed_values(arguments: Sequence[str]) -> list[str]:
    """Join ``--poles -20,-20`` to ``--poles=-20,-20``."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] in _SIGNED and re.match(r"-[\d.]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split()) or type(error).__name__
