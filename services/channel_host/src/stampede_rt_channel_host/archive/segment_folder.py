"""The place of the bytes of segments: a folder, or another object with the same methods. The methods block."""

from __future__ import annotations

import errno
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Protocol

from stampede_rt_channel_host.core.archive import PlacedBlock, ReadAt, Segment, scan
from stampede_rt_channel_host.core.archive.stored_segment import NUMBERS_PER_EPOCH

SUFFIX, DAMAGED = ".segment", ".damaged"


class SegmentPlace(Protocol):
    """Has the segments of one channel. Any threads read at the same time.

    Its methods raise FileNotFoundError if the segment has left the archive, and OSError if it cannot be read.
    """

    def opened(self, number: int) -> AbstractContextManager[ReadAt]:
        """Open a segment. The context gives a function that reads its bytes."""
        ...

    def at_hand(self, number: int) -> AbstractContextManager[ReadAt]:
        """Like `opened`, but only for bytes in memory. Raises BlockingIOError if it would have to wait for a disk."""
        ...

    def blocks(self, segment: Segment, begin: int = 0) -> Sequence[PlacedBlock]:
        """The blocks of a segment from the offset `begin` on, up to the length that `segment` states."""
        ...

    def read_again(self, number: int, offset: int, size: int) -> bytes | None:
        """Bytes of a segment that were damaged, from a better copy; None: there is none."""
        ...

    def is_stored(self, number: int) -> bool:
        """Whether the segment is in an object store, and not in the folder."""
        ...


class SegmentFolder:
    """The segments of one channel as files of a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def file_of(self, number: int) -> Path:
        """The file of a segment, whether it exists or not."""
        return self.path / f"{number:012}{SUFFIX}"

    def numbers(self) -> list[int]:
        """The numbers of the segments in the folder, in ascending order. Raises OSError."""
        return sorted(int(path.stem) for path in self.path.glob(f"*{SUFFIX}") if path.stem.isdecimal())

    @contextmanager
    def opened(self, number: int) -> Iterator[ReadAt]:
        """Open a segment. The context gives a function that reads its bytes."""
        try:
            file = self.file_of(number).open("rb", buffering=0)
        except FileNotFoundError:
            self.check_place()
            raise
        with file:
            yield reads_of(file.fileno())

    def check_place(self) -> None:
        """Check that the folder of all channels exists. Raises OSError, but not FileNotFoundError.

        If that folder is missing, somebody has removed the archive, or its disk is not mounted. If the disk is not
        mounted, no file is lost.
        """
        place = self.path.parent
        if not place.is_dir():
            raise OSError(errno.EIO, f"its folder {place} is missing")

    def check_file(self, number: int, file: int) -> None:
        """Check that an open file is still the file of a segment. Otherwise somebody has removed, renamed or replaced
        it, and the written items are lost. Raises OSError.
        """
        self.check_place()
        path = self.file_of(number)
        if not (path.exists() and os.path.samestat(path.stat(), os.fstat(file))):
            raise OSError(errno.EIO, f"somebody has removed its file {path}")

    def make_again(self) -> None:
        """Make the folder if somebody has removed it. Raises OSError."""
        self.check_place()
        self.path.mkdir(mode=0o700, exist_ok=True)

    @contextmanager
    def at_hand(self, number: int) -> Iterator[ReadAt]:
        """Like `opened`, but only for bytes in memory. Raises BlockingIOError if it would have to wait for a disk."""
        with self.file_of(number).open("rb", buffering=0) as file:
            yield lambda offset, size: _read_at_hand(file.fileno(), offset, size)

    def blocks(self, segment: Segment, begin: int = 0) -> Sequence[PlacedBlock]:
        """The blocks of a segment from the offset `begin` on, up to the length that `segment` states."""
        with self.opened(segment.number) as read_at:
            return scan(read_at, segment.length, check_contents=False, begin=begin).blocks

    def read_again(self, number: int, offset: int, size: int) -> bytes | None:
        """See `SegmentPlace`: a folder has one copy."""
        return None

    def is_stored(self, number: int) -> bool:
        """Whether the segment is in an object store, and not in the folder."""
        return False

    def remove(self, number: int) -> None:
        """Delete a segment, because it leaves the archive. Raises OSError."""
        self.file_of(number).unlink(missing_ok=True)

    def set_aside(self, number: int) -> None:
        """Give the file of a damaged segment a name that the archive does not use. A person may repair it.

        The file stays until the channel is deleted. Raises OSError.
        """
        path = self.file_of(number)
        path.rename(path.with_name(f"{path.name}.{time.time_ns()}{DAMAGED}"))

    def follows_damage(self, number: int | None) -> bool:
        """Whether `set_aside` has renamed the segment that came directly before `number`. None: any segment."""
        stems = (path.name.partition(".")[0] for path in self.path.glob(f"*{SUFFIX}.*{DAMAGED}"))
        aside = {int(stem) for stem in stems if stem.isdecimal()}
        if number is None or number % NUMBERS_PER_EPOCH != 1:
            return bool(aside) if number is None else number - 1 in aside
        return any(one < number for one in aside)

    def remove_all(self, numbers: Sequence[int]) -> int:
        """Delete segments in their order. Stops at a segment that cannot be deleted now. Returns the number of deleted
        segments.
        """
        removed = 0
        with suppress(OSError):
            for number in numbers:
                self.file_of(number).unlink(missing_ok=True)
                removed += 1
        return removed


def reads_of(file: int) -> ReadAt:
    """Reads an open file."""
    return lambda offset, size: os.pread(file, size, offset)


def _read_at_hand(file: int, offset: int, size: int) -> bytes:
    """Bytes from the cache of the system. Raises BlockingIOError if it does not have all of them.

    Raises another OSError if the file system, such as an overlay, cannot refuse to wait.
    """
    found = bytearray(size)
    if sys.platform != "linux" or os.preadv(file, [found], offset, os.RWF_NOWAIT) < size:
        raise BlockingIOError(errno.EAGAIN, "the bytes are not in memory")
    return bytes(found)
