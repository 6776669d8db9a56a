"""Names of the platforms that FMUs have binaries for."""

from __future__ import annotations

import re

import fmpy

__all__ = ["native_platform", "platforms_among"]

# FMI 2.0 folder names of what FMI 3.0 calls architecture-system.
_FMI2_FOLDERS = {
    "linux64": "x86_64-linux",
    "linux32": "x86-linux",
    "win64": "x86_64-windows",
    "win32": "x86-windows",
    "darwin64": "x86_64-darwin",
}
_SUFFIXES = (".so", ".dll", ".dylib")


def native_platform() -> str:
    """Name of this machine's platform, as ``x86_64-linux``."""
    return fmpy.platform_tuple


def platforms_among(names: list[str]) -> tuple[str, ...]:
    """Platforms that an archive has binaries for, by the names of its entries.

    Parameters
    ----------
    names : list of str
    """
    found = {
        _FMI2_FOLDERS.get(match.group(1), match.group(1))
        for name in names
        if name.endswith(_SUFFIXES) and (match := re.fullmatch(r"binaries/([^/]+)/[^/]+", name))
    }
    return tuple(sorted(found))
