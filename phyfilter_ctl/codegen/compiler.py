"""Finds a C compiler and runs it: shared libraries and programs from sources in memory."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from .._output import noted_writes, replacing

__all__ = ["Compiler", "CompilerError", "cached_library", "compile_sources", "find_compiler"]

_NAMES = ("cc", "gcc", "clang")
# Contraction to fused multiply-adds would make results depend on the processor.
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
_SHARED = ("-shared", "-fvisibility=hidden")
_ERROR_LINES = 12
_TIMEOUT = 600.0  # s; zig builds its own C library on first use
# Of the cache; a library of a usual diagram has 30 kB.
_KEPT_LIBRARIES, _KEPT_BYTES = 256, 100_000_000
_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}


class CompilerError(RuntimeError):
    """No C compiler, or one that failed."""


@dataclass(frozen=True)
class Compiler:
    """A C compiler that is there.

    Parameters
    ----------
    command : tuple of str
        Program and leading arguments.
    version : str
        First line of what ``--version`` prints.
    """

    command: tuple[str, ...]
    version: str


def find_compiler(command: str | Path | Sequence[str] | None = None) -> Compiler:
    """The C compiler to use.

    Parameters
    ----------
    command : str, Path or sequence of str, optional
        E.g. "gcc", "/opt/bin/clang", "python -m ziglang cc". By default $CC, else the first there is of cc, gcc, clang
        and ziglang's.

    Raises
    ------
    CompilerError
        If there is none, or the one asked for does not run.

    Examples
    --------
    >>> find_compiler("no-such-compiler")
    Traceback (most recent call last):
        ...
    phyfilter_ctl.codegen.compiler.CompilerError: C compiler 'no-such-compiler' not found; ...
    """
    if command is not None:
        return _checked(_words(command), "")
    if os.environ.get("CC", "").strip():
        return _checked(_words(os.environ["CC"]), " ($CC)")
    for name in _NAMES:
        if shutil.which(name):
            return _checked((name,), "")
    if find_spec("ziglang") is not None:
        return _checked((sys.executable, "-m", "ziglang", "cc"), "")
    raise CompilerError(
        f"no C compiler: tried $CC, {', '.join(_NAMES)} and ziglang; install gcc or clang, or the Python package "
        "ziglang"
    )


def _words(command: str | Path | Sequence[str]) -> tuple[str, ...]:
    if isinstance(command, Path):
        return (str(command),)
    if isinstance(command, str):
        return (command,) if Path(command).exists() else tuple(shlex.split(command))
    return tuple(command)


def _checked(words: tuple[str, ...], origin: str) -> Compiler:
    if not words or shutil.which(words[0]) is None:
        raise CompilerError(
            f"C compiler {' '.join(words)!r}{origin} not found; give the path of gcc, clang or another C99 compiler"
        )
    return Compiler(words, _version(words))


@lru_cache(maxsize=16)
def _version(words: tuple[str, ...]) -> str:
    run = _run([*words, "--version"], "C compiler")
    if run.returncode:
        raise CompilerError(f"C compiler {' '.join(words)!r} fails on --version:\n{_shortened(run)}")
    return run.stdout.splitlines()[0].strip() if run.stdout.strip() else "unknown"


def compile_sources(
    sources: Mapping[str, str],
    output: Path,
    *,
    kind: Literal["shared", "program"] = "shared",
    name: str = "",
    compiler: str | Path | Sequence[str] | None = None,
    flags: Sequence[str] = (),
) -> Path:
    """Compiles C sources to one shared library or program, written in one go.

    Parameters
    ----------
    sources : mapping of str to str
        File name to text; each ``.c`` is compiled.
    output : Path
        Overwritten if it exists, and only if compiling succeeds.
    kind : {"shared", "program"}
        Of a shared library, only symbols marked for export are visible.
    name : str
        Of the model, for error messages.
    compiler : str, Path or sequence of str, optional
        See :func:`find_compiler`.
    flags : sequence of str
        After ``-std=c99 -O2 -ffp-contract=off``.

    Returns
    -------
    Path
        ``output``.

    Raises
    ------
    CompilerError
        If there is no compiler, or it fails: with its first lines.
    ValueError
        If there is nothing to compile, or a file name is not plain.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     compile_sources({"a.c": "int main(void) { return 0; }"}, Path(folder, "a"), kind="program").name
    'a'
    """
    found = find_compiler(compiler)
    files = sorted(file for file in sources if file.endswith(".c"))
    if not files:
        raise ValueError(
            f"sources of {name or 'a model'}: expected at least one .c file, got {sorted(sources)}"
        )
    for file in sources:
        if Path(file).name != file:
            raise ValueError(f"sources: expected plain file names, got {file!r}")
    output = Path(output)
    with tempfile.TemporaryDirectory(prefix="phyfilter_ctl_") as folder:
        for file, text in sources.items():
            Path(folder, file).write_text(text, encoding="utf-8", newline="\n")
        product = Path(folder, "product" + output.suffix)
        options = [*_FLAGS, *(_shared_flags() if kind == "shared" else ()), *flags]
        libraries = [] if sys.platform == "win32" else ["-lm"]
        run = _run(
            [*found.command, *options, *files, "-o", str(product), *libraries],
            f"C compiler of {name or 'a model'}",
            folder,
        )
        if run.returncode:
            raise CompilerError(
                f"{name or 'the model'}: {' '.join(found.command)} ({found.version}) failed:\n{_shortened(run)}"
            )
        # Into place by a rename: another process sees all of it or nothing.
        with replacing(output) as file:
            os.chmod(file.name, 0o700)
            file.write(product.read_bytes())
    return output


def cached_library(
    sources: Mapping[str, str],
    *,
    name: str = "",
    compiler: str | Path | Sequence[str] | None = None,
    flags: Sequence[str] = (),
) -> Path:
    """Shared library of C sources, compiled once per user, compiler and content.

    Parameters
    ----------
    sources, name, compiler, flags
        As of :func:`compile_sources`.

    Returns
    -------
    Path
        In the user's cache folder: $PHYFILTER_CTL_CACHE, $XDG_CACHE_HOME/phyfilter_ctl or ~/.cache/phyfilter_ctl
        (%LOCALAPPDATA% on Windows), or in a private temporary folder where that cannot be written to. It keeps the
        256 libraries used last, and not more than 100 MB.

    Raises
    ------
    CompilerError
        As :func:`compile_sources`.

    Examples
    --------
    >>> text = {"a.c": "int a(void); int a(void) { return 1; }"}
    >>> cached_library(text) == cached_library(text)
    True
    """
    found = find_compiler(compiler)
    digest = hashlib.sha256()
    for part in (*found.command, found.version, *_FLAGS, *_shared_flags(), *flags):
        digest.update(part.encode() + b"\0")
    for file in sorted(sources):
        digest.update(file.encode() + b"\0" + sources[file].encode() + b"\0")
    folder = _cache_folder()
    library = folder / f"{digest.hexdigest()[:32]}{_SUFFIX.get(sys.platform, '.so')}"
    if library.exists():
        os.utime(library)
        return library
    with noted_writes():  # the cache is nobody's output
        compile_sources(sources, library, name=name, compiler=list(found.command), flags=flags)
    forget_oldest(folder)
    return library


def _shared_flags() -> tuple[str, ...]:
    return _SHARED if sys.platform == "win32" else (*_SHARED, "-fPIC")


def _run(command: Sequence[str], what: str, folder: str | None = None) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            list(command),
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise CompilerError(
            f"{what}: no answer within {_TIMEOUT:g} s from {' '.join(command[:3])}"
        ) from error
    except OSError as error:
        raise CompilerError(f"{what}: {command[0]} does not run: {error}") from error


def _shortened(run: subprocess.CompletedProcess[str]) -> str:
    lines = (run.stderr or run.stdout).strip().splitlines()
    more = [f"... and {len(lines) - _ERROR_LINES} lines more"] if len(lines) > _ERROR_LINES else []
    return "\n".join([*lines[:_ERROR_LINES], *more])


@lru_cache(maxsize=1)
def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="phyfilter_ctl_", ignore_cleanup_errors=True)


def _cache_folder() -> Path:
    """A folder that is this user's alone: what lies in it is loaded as code."""
    named = os.environ.get("PHYFILTER_CTL_CACHE")
    if named:
        folder = Path(named)
    elif sys.platform == "win32":
        folder = Path(os.environ.get("LOCALAPPDATA", Path.home())) / "phyfilter_ctl"
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "phyfilter_ctl"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK) and _private(folder):
            return folder
    except OSError:
        pass  # a home that is missing or read-only: this process alone keeps its libraries
    return Path(_temporary_folder().name)


def _private(folder: Path) -> bool:
    if sys.platform == "win32":
        return True
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022


def forget_oldest(folder: Path) -> None:
    """Removes the libraries that were used longest ago, down to the limits of number and size."""
    libraries = [path for path in folder.iterdir() if path.suffix in {".so", ".dll", ".dylib"}]
    dated: list[tuple[float, int, Path]] = []
    for path in libraries:
        try:
            status = path.stat()
        except OSError:
            continue  # another process was first
        dated.append((status.st_mtime, status.st_size, path))
    room = _KEPT_BYTES
    for place, (_, size, path) in enumerate(sorted(dated, reverse=True)):
        room -= size
        if place == 0 or (place < _KEPT_LIBRARIES and room >= 0):
            continue
        try:
            path.unlink()
        except OSError:
            continue  # in use, on Windows
