"""Keeps a list of the objects of a channel on the disk of the host. A host that starts while the object store is
unreachable reads this list instead. Calls block their thread.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

from stampede_rt_channel_host.archive.stable_writes import sync_folder, write_all

_FILE = "objects"
_DROPPED = "dropped"  # stands in place of a name, before the number of the last segment that has left the archive


class ObjectListing(NamedTuple):
    """The objects of a channel, by their names, with their bytes.

    `epoch`: the epoch of the channel at the host that noted the objects.

    These are all objects of the channel if no other host has owned the channel since. `dropped_to`: all segments up to
    this number have left the archive, even if their objects are still in the store.
    """

    epoch: int
    objects: dict[str, int]
    dropped_to: int = 0


class KnownObjects:
    """A file with a line for each change, each with a checksum. Any damage makes the whole list unknown.

    If the host cannot write a line, it deletes the list, and the files continue to move to the object store. On a full
    disk these moves make room.
    """

    def __init__(self, folder: Path, url: str) -> None:
        """`url`: the URL of the object store. A list of another store does not count."""
        self._path, self._url = folder / _FILE, url
        self.changes = 0
        """The number of changes since `replace`. The list has at most this many lines more than it has objects."""

    @property
    def exists(self) -> bool:
        """Whether there is a list. A new channel has none."""
        return self._path.exists()

    def read(self) -> ObjectListing | None:
        """The list, or None if there is none, it is damaged, or it is of another store. Raises OSError."""
        try:
            *lines, rest = self._path.read_text(errors="replace").split("\n")
        except FileNotFoundError:
            return None
        rows = [_decoded(line) for line in lines]
        if not rows or rest or None in rows:
            return None
        (epoch, url), *others = (one for one in rows if one is not None)
        if url != self._url:
            return None
        objects, dropped_to = dict[str, int](), 0
        for number, name in others:
            if name == _DROPPED:
                dropped_to = number
            elif number:
                objects[name] = number
            else:
                objects.pop(name, None)
        return ObjectListing(epoch, objects, dropped_to)

    def replace(self, known: ObjectListing) -> None:
        """Write the list, unless the file has it. If this fails, delete the list. Raises OSError if that fails."""
        self.changes = 0
        dropped = {_DROPPED: known.dropped_to} if known.dropped_to else {}
        content = "".join([_encoded(known.epoch, self._url), *_lines(dropped | known.objects)]).encode()
        if self._path.exists() and self._path.read_bytes() == content:
            return
        draft = self._path.with_suffix(".draft")
        draft.unlink(missing_ok=True)
        try:
            _append(draft, content)
            draft.rename(self._path)
            sync_folder(self._path.parent)
        except OSError:
            draft.unlink(missing_ok=True)
            self._path.unlink(missing_ok=True)

    def add(self, objects: Mapping[str, int]) -> None:
        """Add objects to the list, if there is one. Raises OSError if it can neither write nor delete the list."""
        if not objects or not self._path.exists():
            return
        self.changes += len(objects)
        try:
            _append(self._path, "".join(_lines(objects)).encode())
        except OSError:
            self._path.unlink()

    def delete(self) -> None:
        """Delete the list. Raises OSError."""
        self._path.unlink(missing_ok=True)

    def remove(self, names: Iterable[str]) -> None:
        """Remove objects from the list, because they leave the archive. Raises the errors of `add`."""
        self.add(dict.fromkeys(names, 0))

    def drop(self, names: Iterable[str], to: int) -> None:
        """Remove objects, because all segments up to the number `to` leave the archive."""
        self.add({_DROPPED: to} | dict.fromkeys(names, 0))


def _lines(objects: Mapping[str, int]) -> Iterable[str]:
    return (_encoded(size, name) for name, size in objects.items())


def _encoded(number: int, text: str) -> str:
    row = f"{number} {text}"
    return f"{crc32(row.encode()):08x} {row}\n"


def _decoded(line: str) -> tuple[int, str] | None:
    checksum, _, row = line.partition(" ")
    number, _, text = row.partition(" ")
    if checksum != f"{crc32(row.encode()):08x}" or not number.isdecimal():
        return None
    return int(number), text


def _append(path: Path, content: bytes) -> None:
    """Append bytes, and bring them to stable storage."""
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    try:
        write_all(file, [content])
        os.fsync(file)
    finally:
        os.close(file)
