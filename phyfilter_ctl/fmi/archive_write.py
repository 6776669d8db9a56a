"""FMU archives: the same bytes for the same content, on disk all or not at all."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from .._output import replacing

__all__ = ["write_archive"]

_TIME = (1980, 1, 1, 0, 0, 0)  # the earliest a zip file can say
_UNIX = 3
_FILE, _PROGRAM = 0o100644, 0o100755


def write_archive(path: str | Path, entries: Mapping[str, bytes | str]) -> Path:
    """Writes a zip file with sorted entries, fixed times and rights.

    Parameters
    ----------
    path : str or Path
        Replaced if it exists, and only once the archive is complete.
    entries : mapping of str to bytes or str
        Name with forward slashes to content; text becomes UTF-8.

    Returns
    -------
    Path

    Raises
    ------
    FileNotFoundError
        If the folder to write to does not exist.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     first = write_archive(Path(folder, "a.zip"), {"b": "2", "a": "1"}).read_bytes()
    ...     first == write_archive(Path(folder, "a.zip"), {"a": b"1", "b": b"2"}).read_bytes()
    True
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise FileNotFoundError(
            f"{target.parent}: there is no such folder to write {target.name} to; make it first"
        )
    if target.is_dir():
        raise IsADirectoryError(f"{target} is a folder; expected the name of a file")
    with replacing(target) as stream, zipfile.ZipFile(stream, "w") as archive:
        for name in sorted(entries):
            content = entries[name]
            data = content.encode("utf-8") if isinstance(content, str) else content
            info = zipfile.ZipInfo(name, _TIME)
            info.create_system = _UNIX
            info.external_attr = (_PROGRAM if name.startswith("binaries/") else _FILE) << 16
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data, compresslevel=9)
    return target
