"""The segments of one channel that are in an object store. Its other segments are in its folder. Calls block
their thread.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from stampede_rt_channel_host.archive.clean_stop import CleanStop, name_of_stop, stop_named
from stampede_rt_channel_host.archive.objects.chunk_cache import ChunkCache
from stampede_rt_channel_host.archive.objects.known_objects import KnownObjects, ObjectListing
from stampede_rt_channel_host.archive.objects.segment_store import LaterOwner, SegmentStore
from stampede_rt_channel_host.archive.segment_folder import SegmentFolder
from stampede_rt_channel_host.core.archive import PlacedBlock, ReadAt, Segment, scan
from stampede_rt_channel_host.core.archive.stored_segment import (
    StoredSegment,
    decode_index,
    encode_index,
    first_number,
    object_name,
    segment_named,
    up_to,
)

OBJECTS = "channels"
OUTDATED_MAX = 1000
"""The most names of outdated objects that the host keeps: about 256 KiB."""
# The host writes the list on the disk anew after at least this many changes, and twice as many changes as objects.
CHANGES_LEAST = 1000


class PackedSegment(NamedTuple):
    """A closed segment in the form of an object. `name`: the name of the object."""

    segment: Segment
    name: str
    content: bytearray


class StoredSegments(SegmentFolder):
    """The segments of one channel in a folder and in an object store. A segment in both counts as in the folder.

    Any threads read at the same time, and any thread may call `find`. Only the thread of the archive's writes calls
    `settle` and `remove`.
    """

    def __init__(self, path: Path, cache: ChunkCache, store: SegmentStore) -> None:
        super().__init__(path)
        self.prefix = f"{OBJECTS}/{path.name}/"
        self.outdated: list[str] = []
        """Objects that have left the archive, but not the store."""
        self.has_more_outdated = False
        """Whether the store has more such objects, which `find_outdated` finds."""
        self.stops: dict[str, CleanStop] = {}
        """The clean stops of earlier owners, by the names of their objects, as of the last listing."""
        self._cache, self._store = cache, store
        self._known = KnownObjects(path, store.url)
        self.stored_bytes = 0
        """The bytes of the channel's objects."""
        self._stored: dict[int, StoredSegment] = {}
        self._indexes: dict[int, Sequence[PlacedBlock]] = {}  # for the few segments that overlap with the next one
        self._epoch = 0
        self._dropped_to = 0  # this process has removed segments up to this number; no listing brings them back
        self._limited_to = 0  # the limits have removed all segments up to this number, as the list on the disk says

    @property
    def channel_id(self) -> bytes:
        """The id of the channel."""
        return bytes.fromhex(self.path.name)

    def find(self, epoch: int, following: int | None = None) -> dict[int, StoredSegment]:
        """List the segments in the store, by their numbers. `epoch`: the channel's present epoch. `following`: the
        first seq in the folder.

        Raises StoreError, and LaterOwner if there are segments of a later epoch. Ignores objects that are no segments.
        Any thread may call it.
        """
        found, stops = self._listed()
        end_seq = max((one.segment.end_seq for one in found.values()), default=0)
        if any(one.epoch == epoch - 1 and one.end_seq > end_seq for one in stops.values()):
            found, stops = self._listed()  # the former owner made its last segment and its stop during the listing
        later = [one.name for one in found.values() if one.segment.number >= first_number(epoch + 1)]
        later += [name for name, stop in stops.items() if stop.epoch > epoch]
        if later:
            raise LaterOwner(
                f"the object store {self._store.url} has files of a later owner of the channel ({later[-1]}); "
                "open the channel again"
            )
        self.stops = {name: stop for name, stop in stops.items() if stop.epoch < epoch}
        self._index_overlaps([found[one] for one in sorted(found)], following)
        return found

    def _listed(self) -> tuple[dict[int, StoredSegment], dict[str, CleanStop]]:
        """The segments in the store, and the clean stops, by the names of their objects. Raises StoreError."""
        listed = [(one.name, one.bytes) for one in self._store.find(self.prefix)]
        return self._segments_of(listed), self._stops_of(name for name, _ in listed)

    def _index_overlaps(self, found: Sequence[StoredSegment], following: int | None) -> None:
        """Read the index of each segment that overlaps with the next one: the next segment also has its last items. The
        thread of writes leaves these items out, and then need not wait for the store. Raises StoreError.
        """
        firsts = [*(one.segment.begin for one in found[1:]), following]
        for one, first in zip(found, firsts, strict=False):
            is_cut = first is not None and one.segment.end_seq > first
            if is_cut and one.segment.number not in self._indexes:
                with suppress(FileNotFoundError):  # the limits have just removed the object
                    self._indexes[one.segment.number] = self._indexed(one)

    def known(self, epoch: int, *, is_whole: bool) -> dict[int, StoredSegment] | None:
        """The segments in the store as the disk knows them; None: the disk does not know all of them.

        `epoch`: the channel's present epoch. `is_whole`: no other host has had the channel since this host wrote the
        list on its disk. Raises OSError.
        """
        known = self._known.read()
        if known is None and epoch == 1 and not self.path.exists():  # a new channel
            known = ObjectListing(epoch, {})
        if known is None or not (is_whole or known.epoch in (epoch - 1, epoch)):
            return None
        return self._segments_of(known.objects.items())

    def _segments_of(self, objects: Iterable[tuple[str, int]]) -> dict[int, StoredSegment]:
        found = {}
        for name, size in objects:
            segment = segment_named(name.removeprefix(self.prefix))
            if segment is not None:
                found[segment.number] = StoredSegment(segment, name, size)
        return found

    def _stops_of(self, names: Iterable[str]) -> dict[str, CleanStop]:
        stops = ((one, stop_named(one.removeprefix(self.prefix))) for one in names)
        return {name: stop for name, stop in stops if stop is not None}

    def take_stop(self, epoch: int) -> CleanStop | None:
        """The clean stop of the last owner, if the last listing had it. `epoch`: the channel's present epoch.

        All stops in that listing leave the store: they do not describe this owner's items.
        """
        stops, self.stops = self.stops, {}
        self._note_outdated(stops)
        return next((one for one in stops.values() if one.epoch == epoch - 1), None)

    def name_of_stop(self, stop: CleanStop) -> str:
        """The name of the object that reports a clean stop of this owner."""
        return self.prefix + name_of_stop(stop)

    def note(self, epoch: int) -> None:
        """Note on the disk which segments the store has. `epoch`: the channel's present epoch. Raises OSError."""
        self._epoch = epoch
        self._known.replace(
            ObjectListing(epoch, {one.name: one.bytes for one in self._stored.values()}, self._limited_to)
        )

    def note_epoch(self, epoch: int) -> None:
        """Note the epoch of the channel on the disk, if the list there is of an earlier one. Raises OSError."""
        if 0 < self._epoch < epoch:
            self.note(epoch)

    def note_more(self, segments: Iterable[Segment]) -> None:
        """Note on the disk that the store has these segments, too. Raises OSError."""
        stored = [self._stored[one.number] for one in segments]
        self._known.add({one.name: one.bytes for one in stored})

    def forget_known(self) -> None:
        """Delete the list on the disk. Raises OSError."""
        self._read_dropped()
        self._known.delete()

    def _read_dropped(self) -> None:
        known = self._known.read()
        self._limited_to = max(self._limited_to, known.dropped_to if known is not None else 0)

    def adopt(self, found: Mapping[int, StoredSegment]) -> list[Segment]:
        """Take over the segments of a listing that are new. Returns them.

        Segments that have left the archive may still be in the store after a crash: notes their objects as outdated.

        If a segment is in the folder, too, its file was not deleted after the move: this method deletes it. If the
        object is too short, the file counts. Raises OSError.
        """
        self._read_dropped()
        new = []
        for number, one in found.items():
            if number in self._stored:
                continue
            if number <= self._limited_to:
                self._note_outdated({one.name} - {*self.outdated})
            if number <= max(self._limited_to, self._dropped_to):
                continue
            if self.file_of(number).exists():
                if one.bytes <= one.segment.length:
                    continue
                self.file_of(number).unlink()
            self._add(one)
            new.append(one.segment)
        return new

    def _add(self, stored: StoredSegment) -> None:
        self._stored[stored.segment.number] = stored
        self.stored_bytes += stored.bytes

    def is_stored(self, number: int) -> bool:
        """Whether the store has the segment."""
        return number in self._stored

    @property
    def stored_objects(self) -> int:
        """The number of the channel's segments in the store."""
        return len(self._stored)

    def pack(self, segment: Segment) -> PackedSegment:
        """A closed segment of the folder with its index. Raises OSError."""
        with self.opened(segment.number) as read_at:
            content = bytearray(read_at(0, segment.length))
        if len(content) < segment.length:
            raise OSError(errno.EIO, f"the file of segment {segment.number} is shorter than it was")
        blocks = scan(lambda at, size: bytes(content[at : at + size]), segment.length, check_contents=False).blocks
        content += encode_index(up_to(blocks, segment.length, segment.end_seq))
        return PackedSegment(segment, self.prefix + object_name(segment), content)

    def settle(self, packed: PackedSegment) -> None:
        """Note that the store has a segment, and delete its file. Raises OSError."""
        segment = packed.segment
        if segment.number not in self._stored:
            self._known.add({packed.name: len(packed.content)})
            self._add(StoredSegment(segment, packed.name, len(packed.content)))
        self.file_of(segment.number).unlink(missing_ok=True)

    def remove(self, number: int) -> None:
        """Delete the file of a segment, and add its object to `outdated`. Raises OSError."""
        super().remove(number)
        if number in self._stored:
            self._known.remove([self._stored[number].name])
        self._leave(number)

    def remove_all(self, numbers: Sequence[int]) -> int:
        """Like `SegmentFolder.remove_all`. The list on the disk takes one write for all of them."""
        try:
            self._note_limits(numbers)
        except OSError:
            return 0
        removed = super().remove_all(numbers)
        for number in numbers[:removed]:
            self._leave(number)
        if self._epoch and self._known.changes >= max(CHANGES_LEAST, 2 * len(self._stored)):
            with suppress(OSError):  # a later drop writes the list
                self.note(self._epoch)
        return removed

    def _note_limits(self, numbers: Sequence[int]) -> None:
        """Note on the disk that the oldest segments leave the archive, before anybody deletes them. Raises OSError."""
        if self._epoch and not self._known.exists:
            self.note(self._epoch)
        self._known.drop([self._stored[one].name for one in numbers if one in self._stored], max(numbers))
        self._limited_to = max(self._limited_to, *numbers)

    def _leave(self, number: int) -> None:
        stored = self._stored.pop(number, None)
        self._indexes.pop(number, None)
        self._dropped_to = max(self._dropped_to, number)
        if stored is not None:
            self.stored_bytes -= stored.bytes
            self._note_outdated([stored.name])

    @property
    def has_outdated(self) -> bool:
        """Whether the store has objects that have left the archive."""
        return bool(self.outdated) or self.has_more_outdated

    def _note_outdated(self, names: Iterable[str]) -> None:
        """Add names to `outdated`, up to OUTDATED_MAX: a store may refuse for long to delete objects."""
        for name in names:
            if len(self.outdated) >= OUTDATED_MAX:
                self.has_more_outdated = True
                return
            self.outdated.append(name)

    def find_outdated(self) -> None:
        """List the store for objects of segments that have left the archive. Adds them to `outdated`. Any thread may
        call it. Raises StoreError.
        """
        found, _ = self._listed()
        self.has_more_outdated = False
        gone = (one for number, one in found.items() if number <= self._limited_to and number not in self._stored)
        self._note_outdated(one.name for one in gone)

    @contextmanager
    def opened(self, number: int) -> Iterator[ReadAt]:
        """Open a segment. Yields a function that reads its bytes within the context."""
        stored = self._stored.get(number)
        if stored is not None and not self.file_of(number).exists():
            yield self._reads(stored)
            return
        try:
            with super().opened(number) as read_at:
                yield read_at
        except FileNotFoundError:
            if (stored := self._stored.get(number)) is None:
                raise
            yield self._reads(stored)

    def _reads(self, stored: StoredSegment) -> Callable[[int, int], bytes]:
        end = stored.bytes
        return lambda at, size: self._cache.read(stored.name, at, max(0, min(size, end - at)))

    def blocks(self, segment: Segment, begin: int = 0) -> Sequence[PlacedBlock]:
        """The blocks of a segment from the offset `begin` on, up to the length that `segment` states."""
        stored = self._stored.get(segment.number)
        if stored is None or self.file_of(segment.number).exists():
            found = super().blocks(segment, begin)
        else:
            indexed = self._indexes.get(segment.number) or self._indexed(stored)
            found = [one for one in indexed if one.offset >= begin]
        return up_to(found, segment.length, segment.end_seq)

    def _indexed(self, stored: StoredSegment) -> Sequence[PlacedBlock]:
        """The blocks of an object, from its index; if the index is damaged, from the heads of the blocks."""
        length = stored.segment.length
        index = self._cache.read(stored.name, length, max(0, stored.bytes - length))
        found = decode_index(index, length)
        if found is not None:
            return found
        self._cache.forget(stored.name, length, stored.bytes - length)
        return scan(self._reads(stored), min(length, stored.bytes), check_contents=False).blocks

    def read_again(self, number: int, offset: int, size: int) -> bytes | None:
        """Bytes of a segment from the store, past the cache; None: the segment is not there. Raises OSError."""
        stored = self._stored.get(number)
        if stored is None:
            return None
        self._cache.forget(stored.name, offset, size)
        return self._cache.read(stored.name, offset, size)

    def has_object(self, name: str, size: int) -> bool:
        """Whether the store has this object with this size. Raises StoreError."""
        return any(one.name == name and one.bytes == size for one in self._store.find(self.prefix))
