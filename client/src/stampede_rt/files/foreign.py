"""Opens a file of any kind as a source of items, by its content."""

from __future__ import annotations

import os
from pathlib import Path

from stampede_rt.errors import FileError
from stampede_rt.files.file_source import FileSource
from stampede_rt.files.framing import MAGIC
from stampede_rt.files.rosbag_source import RosbagSource
from stampede_rt.files.sources import McapSource
from stampede_rt.files.xdf_source import XdfSource

_XDF_MAGIC = b"XDF:"
_SQLITE_MAGIC = b"SQLite format 3\x00"


def source_of(path: str | os.PathLike[str]) -> FileSource:
    """Open a file as a source, by its content. Raises FileError."""
    found = Path(path)
    if found.is_dir() and not (found / "metadata.yaml").is_file():
        raise FileError(f"{os.fspath(path)!r} is a folder, and no rosbag2: it has no metadata.yaml; name a file")
    if found.is_dir():
        return RosbagSource(found)
    try:
        with found.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise FileError(f"the file {os.fspath(path)!r} cannot be read: {error.strerror}") from error
    if head.startswith(MAGIC):
        return McapSource(found)
    if head == _SQLITE_MAGIC:
        return RosbagSource(found)
    if head.startswith(_XDF_MAGIC):
        return XdfSource(found)
    raise FileError(
        f"the file {os.fspath(path)!r} is neither MCAP, nor rosbag2, nor XDF; unpack a packed file (.xdfz, .zstd) "
        "first, or name the folder of a rosbag2"
    )
