"""Binaries of an FMU: for this machine with the system's compiler, for others with ziglang's."""

from __future__ import annotations

import platform
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from ..codegen.compiler import CompilerError, compile_sources, find_compiler
from .glue import fmi_headers

__all__ = ["PLATFORMS", "Platform", "build_binaries", "native_platform", "platform_names"]


@dataclass(frozen=True)
class Platform:
    """A machine that FMUs run on.

    Parameters
    ----------
    name : str
        FMI 3's platform tuple, such as "x86_64-linux".
    fmi2 : str
        Folder in FMI 2; what the standard does not name has FMI 3's tuple.
    target : str
        As ziglang's compiler calls it.
    suffix : str
        Of shared libraries.
    """

    name: str
    fmi2: str
    target: str
    suffix: str

    def folder(self, fmi: str) -> str:
        """Folder in binaries/.

        Parameters
        ----------
        fmi : {"2.0", "3.0"}
        """
        return self.fmi2 if fmi == "2.0" else self.name


# glibc 2.17 is that of manylinux2014: any Linux since 2014 has it.
PLATFORMS = {
    platform.name: platform
    for platform in (
        Platform("x86_64-linux", "linux64", "x86_64-linux-gnu.2.17", ".so"),
        Platform("aarch64-linux", "aarch64-linux", "aarch64-linux-gnu.2.17", ".so"),
        Platform("x86_64-windows", "win64", "x86_64-windows-gnu", ".dll"),
        Platform("x86_64-darwin", "darwin64", "x86_64-macos", ".dylib"),
        Platform("aarch64-darwin", "aarch64-darwin", "aarch64-macos", ".dylib"),
    )
}
_SYSTEMS = {"linux": "linux", "win32": "windows", "darwin": "darwin"}
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def native_platform() -> Platform:
    """This machine.

    Raises
    ------
    CompilerError
        If no binaries can be made for it.
    """
    system, machine = _SYSTEMS.get(sys.platform, sys.platform), platform.machine().lower()
    name = f"{_MACHINES.get(machine, machine)}-{system}"
    if name not in PLATFORMS:
        raise CompilerError(f"no FMU binaries for {name}; expected one of {', '.join(PLATFORMS)}")
    return PLATFORMS[name]


def platform_names(platforms: Sequence[str] | Literal["all"]) -> tuple[str, ...]:
    """Checks a choice of platforms; "native" stays as it is.

    Parameters
    ----------
    platforms : sequence of str or "all"

    Raises
    ------
    ValueError
        If one is not known.

    Examples
    --------
    >>> platform_names("all")
    ('x86_64-linux', 'aarch64-linux', 'x86_64-windows', 'x86_64-darwin', 'aarch64-darwin')
    """
    if platforms == "all":
        return tuple(PLATFORMS)
    names = (platforms,) if isinstance(platforms, str) else tuple(platforms)
    unknown = [name for name in names if name != "native" and name not in PLATFORMS]
    if unknown:
        raise ValueError(f"platforms: expected 'all', 'native' or {', '.join(PLATFORMS)}; got {unknown[0]!r}")
    return tuple(dict.fromkeys(names))


def build_binaries(
    sources: Mapping[str, str],
    *,
    name: str,
    fmi: str,
    platforms: Sequence[str],
    compiler: str | Path | Sequence[str] | None = None,
    flags: Sequence[str] = (),
) -> dict[str, bytes]:
    """Shared libraries of an FMU.

    Parameters
    ----------
    sources : mapping of str to str
        The folder sources.
    name : str
        The model identifier.
    fmi : {"2.0", "3.0"}
    platforms : sequence of str
        "native", for the compiler of this machine, or names of :data:`PLATFORMS`, for ziglang's.
    compiler : str, Path or sequence of str, optional
        For "native"; see :func:`find_compiler`.
    flags : sequence of str
        More for the compiler, such as libraries.

    Returns
    -------
    dict of str to bytes
        ``binaries/<folder>/<name>.<suffix>`` to content.

    Raises
    ------
    CompilerError
        If a compiler is missing or fails.
    """
    files = {**fmi_headers(fmi), **sources}
    found: dict[str, bytes] = {}
    for chosen in platforms:
        target = native_platform() if chosen == "native" else PLATFORMS[chosen]
        command = find_compiler(compiler).command if chosen == "native" else _cross_compiler(target)
        with tempfile.TemporaryDirectory(prefix="phyfilter_ctl_") as folder:
            library = Path(folder, name + target.suffix)
            compile_sources(
                files,
                library,
                name=name,
                compiler=command,
                flags=(*_flags(target, name, _is_zig(command)), *flags),
            )
            found[f"binaries/{target.folder(fmi)}/{name}{target.suffix}"] = library.read_bytes()
    return found


def _cross_compiler(target: Platform) -> tuple[str, ...]:
    if find_spec("ziglang") is None:
        raise CompilerError(
            f"a binary for {target.name} needs ziglang's compiler: pip install 'phyfilter-ctl[cross]', or leave it at "
            "platforms=('native',)"
        )
    return (sys.executable, "-m", "ziglang", "cc", "-target", target.target)


def _is_zig(command: Sequence[str]) -> bool:
    return "ziglang" in command or "zig" in (Path(word).name for word in command)


def _flags(target: Platform, name: str, zig: bool) -> tuple[str, ...]:
    """Small and the same from build to build: no debug data, build numbers or names of temporary files."""
    if target.suffix == ".dylib":
        return ("-g0", f"-Wl,-install_name,@rpath/{name}.dylib")
    if target.suffix == ".dll":
        return ("-g0", "-s")
    return (
        "-g0",
        "-s",
        "-Wl,--gc-sections",
        "-ffunction-sections",
        "-fno-asynchronous-unwind-tables",  # nothing here throws
        *(() if zig else ("-Wl,--build-id=none", "-fno-align-functions", "-fno-align-jumps")),
    )
