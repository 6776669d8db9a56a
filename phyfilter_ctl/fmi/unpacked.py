"""FMUs in private temporary folders, from where their code can be loaded."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path

from .archive import ArchiveLimits, unpack
from .foreign import Isolation
from .inspect import FmuDescription, Scalar, describe
from .platforms import native_platform
from .structure import resized, structure_among

__all__ = ["UnpackedFmu"]


class UnpackedFmu:
    """An FMU in a private temporary folder, which is removed by :meth:`close` or with this object.

    Parameters
    ----------
    path : str or Path
    limits : ArchiveLimits, optional
    isolated : bool or Isolation
        Whether its instances run in processes of their own, and within which limits of time.
    structure : dict of str to int, optional
        Structural parameters that differ from the FMU's; other values may be among them, and are left alone.

    Attributes
    ----------
    description : FmuDescription
        With the arrays as long as the structural parameters make them.
    structure : dict of str to int
        Those that were given.
    folder : Path
    isolation : Isolation or None

    Raises
    ------
    ValueError
        As for :func:`describe`; if the FMU has no binary for this platform (those it has are named).
    """

    def __init__(
        self,
        path: str | Path,
        *,
        limits: ArchiveLimits | None = None,
        isolated: bool | Isolation = False,
        structure: Mapping[str, Scalar] | None = None,
    ) -> None:
        self.isolation: Isolation | None = (
            isolated if isinstance(isolated, Isolation) else Isolation() if isolated else None
        )
        self.description: FmuDescription = describe(path, limits=limits)
        self.structure: dict[str, Scalar] = structure_among(self.description, structure or {})
        if self.structure:
            self.description = resized(self.description, self.structure, limits=limits)
        here = native_platform()
        if here not in self.description.platforms:
            has = ", ".join(map(_with_width, self.description.platforms)) or "none"
            remedy = (
                "; its C sources are inside: build them with fmpy.build.build_platform_binary"
                if self.description.sources
                else "; ask for an export for this platform"
            )
            raise ValueError(f"{path}: no binary for {here}; it has binaries for {has}{remedy}")
        folder = tempfile.mkdtemp(prefix="phyfilter-")
        self._remove = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.folder: Path = Path(folder)
        try:
            unpack(path, self.folder, limits)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Remove the folder."""
        self._remove()


def _with_width(platform: str) -> str:
    return f"{platform} (32-bit)" if platform.startswith("x86-") else platform
