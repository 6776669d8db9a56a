"""Files of a system structure package, each read once however often it is used."""

from __future__ import annotations

import tempfile
from pathlib import Path
from urllib.parse import unquote, urlsplit

import lxml.etree as etree

from .archive import ArchiveLimits, parse_xml, unpack
from .ssp_values import validate

__all__ = ["SspFiles"]


class SspFiles:
    """An unpacked package, and those inside it.

    Parameters
    ----------
    path : Path
        Of the package, for messages.
    folder : Path
        Where it is unpacked.
    limits : ArchiveLimits, optional

    Attributes
    ----------
    folder : Path
        That of the package whose system is being read.
    """

    def __init__(self, path: Path, folder: Path, limits: ArchiveLimits | None) -> None:
        self.folder: Path = folder
        self._whole = folder
        self._path, self._limits = path, limits
        self._trees: dict[Path, etree._Element] = {}
        self._valid: set[Path] = set()
        self._unpacked: dict[Path, Path] = {}
        self._met = 0

    def meet(self, count: int) -> None:
        """Count elements and values each time they are used: a few lines may stand for more than any memory holds.

        Parameters
        ----------
        count : int

        Raises
        ------
        ValueError
            If there are more than the limit of scalars.
        """
        self._met += count
        most = (self._limits or ArchiveLimits()).scalars
        if self._met > most:
            raise ValueError(f"{self._path}: more than {most} elements and parameter values; refused")

    def within(self, source: str, name: str) -> Path:
        """File that a package names.

        Parameters
        ----------
        source : str
            URI, relative to the package.
        name : str
            Of the component, for messages.

        Raises
        ------
        ValueError
            If it is not inside the package.
        """
        parts, target = urlsplit(source), self.folder
        try:
            target = (self.folder / unquote(parts.path)).resolve()
            known = target.is_relative_to(self.folder.resolve()) and target.is_file()
        except OSError:  # longer than any name
            known = False
        if not known or parts.scheme or parts.netloc:
            raise ValueError(
                f"{self._path}: {name}: expected a file inside the package, got {source[:200]!r}"
            )
        return target

    def parsed(self, file: Path) -> etree._Element:
        """Root of a document.

        Parameters
        ----------
        file : Path
        """
        if file not in self._trees:
            self._trees[file] = parse_xml(file.read_bytes(), f"{self._path}: {file.name}", self._limits)
        return self._trees[file]

    def structure(self, file: Path) -> etree._Element:
        """Root of an .ssd file, which its schema allows.

        Parameters
        ----------
        file : Path

        Raises
        ------
        ValueError
            If there is none, or it is not valid.
        """
        if not file.is_file():
            raise ValueError(f"{self._path}: no {file.name} inside: not a system structure package")
        root = self.parsed(file)
        if file not in self._valid:
            validate(self._path, root)
            self._valid.add(file)
        return root

    def enter(self, package: Path) -> Path:
        """Go into a package inside this one; returns its .ssd file.

        Parameters
        ----------
        package : Path
        """
        if package not in self._unpacked:
            folder = Path(tempfile.mkdtemp(dir=self.folder))
            # What all packages unpack counts against one limit.
            unpack(package, folder, (self._limits or ArchiveLimits()).after(self._whole))
            self._unpacked[package] = folder
        self.folder = self._unpacked[package]
        return self.folder / "SystemStructure.ssd"
