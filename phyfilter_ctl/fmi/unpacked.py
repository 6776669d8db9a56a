"""FMUs in private temporary folders, from where their code can be loaded."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from pathlib import Path

from .archive import unpack
from .fmu import Fmu
from .foreign import Isolation
from .inspect import FmuDescription, Scalar, describe
from .platforms import native_platform
from .structure import resized, structure_among

__all__ = ["UnpackedFmu"]


class UnpackedFmu:
    """An FMU in a private temporary folder, which is removed by :meth:`close` or with this object.

    Parameters
    ----------
    fmu : str, Path or Fmu
        Structural parameters among its parameters make the lengths of arrays.
    isolated : bool
        Whether its instances run in processes of their own, where the FMU leaves that open.

    Attributes
    ----------
    description : FmuDescription
        With the arrays as long as the structural parameters make them.
    structure : dict of str to int
        Structural parameters that were given.
    values : dict
        The other parameters that were given.
    folder : Path
    isolation : Isolation or None

    Raises
    ------
    ValueError
        As for :func:`describe`; if the FMU has no binary for this platform (those it has are named).
    """

    def __init__(
        self,
        fmu: str | Path | Fmu,
        *,
        isolated: bool = False,
    ) -> None:
        fmu = Fmu.of(fmu)
        path, limits = fmu.path, fmu.limits
        chosen = isolated if fmu.isolated is None else fmu.isolated
        self.isolation: Isolation | None = (
            chosen if isinstance(chosen, Isolation) else Isolation() if chosen else None
        )
        self.description: FmuDescription = describe(path, limits=limits)
        self.structure: dict[str, Scalar] = structure_among(self.description, fmu.parameters)
        self.values: dict[str, Scalar] = {
            name: value for name, value in fmu.parameters.items() if name not in self.structure
        }
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
