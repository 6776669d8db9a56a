"""FMU and SSP archives of unknown origin, read without trusting them."""

from __future__ import annotations

import math
import os
import re
import shutil
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from xml.parsers import expat

import lxml.etree as etree

from .._output import naming

__all__ = [
    "ArchiveLimits",
    "archive_entries",
    "extracted",
    "parse_xml",
    "read_entries",
    "read_entry",
    "refuse_sizes",
    "unpack",
]

_CHUNK = 1 << 16
# Archives of this project and of the common tools are stored or deflated; FMI and SSP allow nothing else.
_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
# Of a file and of a path with the folder around it, on the common systems.
_LONGEST, _LONGEST_PATH = 255, 3000
_LONGEST_NAME = 2000  # of a variable
# Below this, a high compression ratio says nothing (empty tables compress well) and harms nobody.
_SMALL = 1 << 20
_DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError, ValueError)


@dataclass(frozen=True)
class ArchiveLimits:
    """What an archive may hold at most.

    Parameters
    ----------
    entries : int
        Files and folders.
    size : int
        Bytes of all files together, unpacked.
    ratio : float
        Unpacked over packed size of one file, where it is over 1 MiB.
    xml : int
        Bytes of one XML document.
    scalars : int
        Variables of an FMU, arrays by their elements.
    """

    entries: int = 10_000
    size: int = 2 << 30
    ratio: float = 200.0
    xml: int = 64 << 20
    scalars: int = 1_000_000

    def after(self, folder: Path) -> ArchiveLimits:
        """What is left of the size for archives inside one that is unpacked.

        Parameters
        ----------
        folder : Path
            With all that was unpacked so far.
        """
        taken = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        return replace(self, size=max(self.size - taken, 0))


def archive_entries(path: str | Path, limits: ArchiveLimits | None = None) -> tuple[zipfile.ZipInfo, ...]:
    """Directory of an archive, refused as a whole if one entry is not harmless.

    Parameters
    ----------
    path : str or Path
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        If the file is no archive; if an entry would be written outside its folder (absolute paths, drive letters,
        "..", backslashes), is a link or a device, is encrypted or compressed in an unusual way; if two entries have
        the same name, also but for the case, and not the same content; if a limit is exceeded.
    FileNotFoundError
        If there is no such file.
    """
    limits = limits or ArchiveLimits()
    with _opened(Path(path)) as archive:
        return _checked(Path(path), archive, limits)


def read_entry(path: str | Path, name: str, limits: ArchiveLimits | None = None) -> bytes:
    """One file of an archive.

    Parameters
    ----------
    path : str or Path
    name : str
        As in the archive, with forward slashes.
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        As for :func:`archive_entries`; if there is no such entry; if it is damaged.
    """
    _, found = read_entries(path, [name], limits)
    if name not in found:
        raise ValueError(f"{path}: expected an entry {name!r}; there is none")
    return found[name]


def read_entries(
    path: str | Path, names: Sequence[str], limits: ArchiveLimits | None = None
) -> tuple[tuple[zipfile.ZipInfo, ...], dict[str, bytes]]:
    """Directory of an archive, and those of some files that it has.

    Parameters
    ----------
    path : str or Path
    names : sequence of str
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        As for :func:`archive_entries`; if a file is damaged.
    """
    limits = limits or ArchiveLimits()
    path = Path(path)
    with _opened(path) as archive:
        entries = _checked(path, archive, limits)
        wanted = [entry for entry in entries if entry.filename in names]
        return entries, {
            entry.filename: b"".join(_pieces(path, archive, entry, limits, limits.size)) for entry in wanted
        }


def unpack(path: str | Path, folder: Path, limits: ArchiveLimits | None = None) -> None:
    """Unpack an archive into an existing, empty folder.

    Parameters
    ----------
    path : str or Path
    folder : Path
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        As for :func:`archive_entries`; if a file is damaged or larger than its entry says; if an XML document that
        describes the archive declares a document type (entities, external files).
    """
    limits = limits or ArchiveLimits()
    path = Path(path)
    left = limits.size
    with _opened(path) as archive:
        for entry in _checked(path, archive, limits):
            target = folder.joinpath(*entry.filename.rstrip("/").split("/"))
            if entry.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with naming(target), target.open("xb") as file:
                for piece in _pieces(path, archive, entry, limits, left):
                    left -= len(piece)
                    file.write(piece)
    for document in _descriptions(folder):
        with suppress(NotWellFormedError):  # whoever reads it will say so
            parse_xml(document.read_bytes(), f"{path}: {document.relative_to(folder).as_posix()}", limits)


@contextmanager
def extracted(path: str | Path, limits: ArchiveLimits | None = None) -> Iterator[Path]:
    """Private temporary folder with the content of an archive; removed at the end.

    Parameters
    ----------
    path : str or Path
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        As for :func:`unpack`.
    OSError
        If the disk of temporary files is full: the folder is named.
    """
    folder = Path(tempfile.mkdtemp(prefix="phyfilter-"))
    try:
        with naming(folder):
            unpack(path, folder, limits)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def parse_xml(data: bytes, name: str, limits: ArchiveLimits | None = None) -> etree._Element:
    """Root of an XML document that may come from anywhere.

    Parameters
    ----------
    data : bytes
    name : str
        For messages.
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        If it is not well-formed, larger than the limit, or declares a document type: without one there are no
        entities to expand and no external files to read.
    """
    limits = limits or ArchiveLimits()
    if len(data) > limits.xml:
        raise ValueError(f"{name}: {len(data)} bytes, expected at most {limits.xml}")
    scanner = expat.ParserCreate()
    doctypes: list[str] = []
    scanner.StartDoctypeDeclHandler = lambda doctype, *_: _stop(doctypes, doctype)
    options = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        scanner.Parse(data, True)
        return etree.fromstring(data, options)
    except _FoundDoctypeError as error:
        raise ValueError(
            f"{name}: declares a document type ({doctypes[0]!r}); refused, as entities may expand without bound and "
            "read other files. FMI and SSP documents need none"
        ) from error
    except (
        expat.ExpatError,
        etree.XMLSyntaxError,
        LookupError,
        ValueError,
    ) as error:  # the last two: encodings
        raise NotWellFormedError(f"{name}: not a well-formed XML document: {error}") from error


class NotWellFormedError(ValueError):
    """An XML document that cannot be parsed."""


def refuse_sizes(
    path: Path, shapes: Iterable[tuple[str, tuple[int, ...]]], limits: ArchiveLimits | None
) -> None:
    """Dimensions cost a few bytes to write and all memory to unfold, a long name minutes to parse.

    Parameters
    ----------
    path : Path
    shapes : iterable of (str, tuple of int)
        Name and dimensions of each variable.
    limits : ArchiveLimits, optional

    Raises
    ------
    ValueError
        If a size is negative, the variables have more scalars together than the limit, or a name has over 2000
        characters.
    """
    most, scalars = (limits or ArchiveLimits()).scalars, 0
    for name, shape in shapes:
        if len(name) > _LONGEST_NAME:
            raise ValueError(
                f"{path}: a variable's name has {len(name)} characters ({name[:40]}...), expected at most "
                f"{_LONGEST_NAME}; refused"
            )
        scalars += math.prod(shape)
        if min(shape, default=0) < 0 or scalars > most:
            raise ValueError(
                f"{path}: {name}: dimensions {' x '.join(map(str, shape))}; expected sizes of at least 0 and at most "
                f"{most} scalars in all variables together; refused"
            )


class _FoundDoctypeError(Exception):
    """Ends the scan before a declaration within the document type is read."""


def _stop(doctypes: list[str], doctype: str) -> None:
    doctypes.append(doctype)
    raise _FoundDoctypeError


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    if not path.exists():
        raise FileNotFoundError(f"{path}: there is no such file")
    if not path.is_file():
        raise ValueError(f"{path}: expected an archive, got a folder")
    try:
        archive = zipfile.ZipFile(path)
    except _DAMAGE as error:
        raise ValueError(f"{path}: no ZIP archive, or a damaged one: {error}") from error
    with archive:
        yield archive


def _checked(path: Path, archive: zipfile.ZipFile, limits: ArchiveLimits) -> tuple[zipfile.ZipInfo, ...]:
    # Some tools list the folder itself.
    entries = [entry for entry in archive.infolist() if entry.orig_filename != "./"]
    if len(entries) > limits.entries:
        raise ValueError(f"{path}: {len(entries)} entries, expected at most {limits.entries}")
    seen: dict[str, str] = {}
    folders: dict[str, str] = {}
    first: dict[str, zipfile.ZipInfo] = {}
    for entry in list(entries):
        problem = _unsafe_name(entry) or _unusual(entry, limits)
        if problem:
            raise ValueError(f"{path}: entry {entry.orig_filename!r} {problem}; refused")
        key = entry.filename.rstrip("/").casefold()
        # A folder named again does no harm, nor does a file that is there twice with one content.
        if key in seen and seen[key] == entry.filename:
            known = first[key]
            if (
                not entry.is_dir()
                and _content(entry) == _content(known)
                and _same(path, archive, known, entry, limits)
            ):
                entries.remove(entry)
                continue
        if key in seen and not (entry.is_dir() and seen[key] == entry.filename):
            raise ValueError(
                f"{path}: two entries of one name, {seen[key]!r} and {entry.filename!r}; refused"
            )
        seen[key], first[key] = entry.filename, entry
        parents = key.split("/")[: None if entry.is_dir() else -1]
        folders.update({"/".join(parents[: i + 1]): entry.filename for i in range(len(parents))})
    for entry in entries:
        key = entry.filename.casefold()
        if not entry.is_dir() and key in folders:
            raise ValueError(f"{path}: {entry.filename!r} is a file and a folder ({folders[key]!r}); refused")
    total = sum(entry.file_size for entry in entries)
    if total > limits.size:
        raise ValueError(f"{path}: {total} bytes unpacked, expected at most {limits.size}; refused")
    return tuple(entries)


def _content(entry: zipfile.ZipInfo) -> tuple[int, int]:
    return entry.file_size, entry.CRC


def _same(
    path: Path, archive: zipfile.ZipFile, one: zipfile.ZipInfo, other: zipfile.ZipInfo, limits: ArchiveLimits
) -> bool:
    pieces = (_pieces(path, archive, entry, limits, limits.size) for entry in (one, other))
    return all(a == b for a, b in zip_longest(*pieces))


def _unsafe_name(entry: zipfile.ZipInfo) -> str:
    name = entry.orig_filename  # zipfile cuts `filename` at a NUL
    if re.search(r"[\x00-\x1f\x7f]", name):
        return "has a control character in its name"
    if "\\" in name:
        return "has a backslash in its name"
    if name.startswith("/"):
        return "has an absolute path"
    if ":" in name:
        return "has a drive letter or a stream in its name"
    parts = name.removesuffix("/").split("/")
    if ".." in parts:
        return "leads out of its folder"
    if "" in parts or "." in parts:
        return "has an empty part in its path"
    if (
        any(len(part.encode("utf-8", "surrogatepass")) > _LONGEST for part in parts)
        or len(name) > _LONGEST_PATH
    ):
        return f"has a name longer than {_LONGEST} bytes, or a path longer than {_LONGEST_PATH}, which no disk takes"
    if any(part.endswith((".", " ") if os.name == "nt" else " ") for part in parts):
        return "has a name that ends in a dot or a space, which this system may drop"
    return ""


def _unusual(entry: zipfile.ZipInfo, limits: ArchiveLimits) -> str:
    mode = entry.external_attr >> 16
    kind = stat.S_IFMT(mode)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "is a link" if stat.S_ISLNK(mode) else "is neither a file nor a folder"
    if entry.flag_bits & 0x1:
        return "is encrypted"
    if entry.compress_type not in _METHODS:
        return f"is compressed by method {entry.compress_type}, expected stored or deflated"
    if entry.file_size > max(_SMALL, limits.ratio * entry.compress_size):
        ratio = entry.file_size / max(entry.compress_size, 1)
        return f"unpacks to {ratio:.0f} times its size, expected at most {limits.ratio:g}"
    return ""


def _pieces(
    path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo, limits: ArchiveLimits, left: int
) -> Iterator[bytes]:
    """Content of an entry; what an entry says of its size is not believed."""
    allowed = min(left, entry.file_size)
    try:
        with archive.open(entry) as file:
            while piece := file.read(_CHUNK):
                allowed -= len(piece)
                if allowed < 0:
                    raise ValueError(f"larger than the {entry.file_size} bytes its entry says")
                yield piece
    except _DAMAGE as error:
        raise ValueError(f"{path}: entry {entry.filename!r} cannot be read: {error}") from error


def _descriptions(folder: Path) -> list[Path]:
    """XML documents that other readers will parse with less care."""
    patterns = (
        "modelDescription.xml",
        "sources/buildDescription.xml",
        "terminalsAndIcons/*.xml",
        "*.ssd",
        "**/*.ssv",
        "**/*.ssm",
        "**/*.ssb",
    )
    return [path for pattern in patterns for path in sorted(folder.glob(pattern)) if path.is_file()]
