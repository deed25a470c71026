"""The segments of a channel. The closed segments move to an object store. The methods block."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.archive.clean_stop import CleanStop, OwnPart, read_stop
from stampede_rt_channel_host.archive.kept_blocks import KeptBlocks
from stampede_rt_channel_host.archive.objects.segment_store import StoreError
from stampede_rt_channel_host.archive.objects.stored_segments import PackedSegment, StoredSegments
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, OpenedArchive, SegmentFiles
from stampede_rt_channel_host.core.archive import CutRun, Segment, begun_by
from stampede_rt_channel_host.core.archive.stored_segment import StoredSegment, first_number


class MovingFiles(SegmentFiles):
    """The segments of a channel, some of them in the folder and the others in the store.

    `is_left`: another `MovingFiles` has opened the folder, or the channel was deleted. `is_given_up`: the host does not
    record the channel any more. Only the thread of writes calls the methods that change something.
    """

    def __init__(
        self,
        folder: Path,
        facts: dict[str, str | int],
        place: StoredSegments,
        cut: CutRun,
        kept: KeptBlocks | None = None,
    ) -> None:
        """`facts` and `kept`: see `SegmentFiles`."""
        super().__init__(folder, facts, kept, place)
        self.stored, self.cut = place, cut
        self.is_shared = True
        self.is_left = self.is_given_up = False
        self._unplaced: list[Segment] = []  # segments of the former owner, if an error interrupted `find_again`
        self._wide: dict[int, Segment] = {}  # whole segments whose remaining items the host could not look up
        self.waiting: tuple[Segment, ...] = ()
        """The closed segments that have not moved yet, as of the last `look`."""
        self.former_stop: CleanStop | None = None
        """The clean stop of the last owner, if a listing of the store had it."""
        self._stop: CleanStop | None = None  # the clean stop of this owner

    def known(self, epoch: int, incarnation: int) -> Mapping[int, StoredSegment] | None:
        """The segments in the store as the disk knows them; None: it may not know all of them. Raises OSError.

        `epoch`, `incarnation`: the present ones of the channel.
        """
        if self.is_moving_here:
            return None
        stop = read_stop(self._folder)
        is_whole = stop is not None and stop.incarnation == incarnation
        return self.stored.known(epoch, is_whole=is_whole)

    def open_found(self, epoch: int, incarnation: int, found: Mapping[int, StoredSegment]) -> OpenedArchive:
        """Do the same as `open`. `found`: the segments in the store. Raises OSError."""
        opened = self.open(epoch, incarnation, self.stored.adopt(found))
        self.stored.note(epoch)
        if self.is_listed and not self.is_moving_here:
            self.former_stop = self.stored.take_stop(epoch)
        return opened._replace(stop=opened.stop or self.former_stop)

    def open_unknown(self, epoch: int, incarnation: int) -> OpenedArchive:
        """Open the archive at a host that does not know the segments in the store. Raises OSError."""
        opened = self.open(epoch, incarnation)
        self.stored.forget_known()
        self.is_known = self.is_listed = False
        own = None if opened.stop is None else self._own_part(opened.stop.end_seq)
        return opened._replace(stop=opened.stop and opened.stop._replace(end_seq=0), own=own)

    def _without(self, segment: Segment, following: int | None) -> Segment | None:
        """See `SegmentFiles`. If the host opens the archive while the store is unreachable, the segment may have wider
        bounds than its remaining items, until the store is back. Reads of the segment need the store anyway.
        """
        try:
            return super()._without(segment, following)
        except StoreError:
            if self.is_listed:
                raise
            assert following is not None, "otherwise the segment stays whole"
            items = min(segment.items, given_between(segment.first_seq, following))
            low, high = (segment.low, segment.high) if items else (None, None)
            self._wide[segment.number] = segment
            rest = segment._replace(items=items, low=low, high=high, end_seq=max(following, segment.begin))
            return begun_by(rest, following)

    def _own_part(self, end_seq: int) -> OwnPart | None:
        """The beginning of the last segments in the folder that follow each other without a hole.

        None unless the last segment ends at the seq `end_seq`, and these segments have items.
        """
        found = None
        for segment in reversed(self._segments):
            if segment.end_seq != end_seq:
                break
            accepted = [one.head.first_accepted for one in self._files.blocks(segment) if one.head.items]
            found = OwnPart(segment.first_seq, accepted[0]) if accepted else found
            end_seq = segment.first_seq
        return found

    def look(self, now: int, close_after_nanos: int, limits: ArchiveLimits | None) -> None:
        """Close the open segment if its first item is older than `close_after_nanos`. Drop outdated segments, unless
        `limits` is None. Find the segments that are to move. Raises OSError.
        """
        if self.is_left:
            self.waiting = ()
            return
        is_young = 0 <= now - self._begun_at < close_after_nanos  # not if the clock went back
        if self._file is not None and self.is_known and not is_young:
            self._end_segment()
        if limits is not None:
            self.drop_outdated(limits, now)
        self.stored.note_epoch(self._epoch)
        local = self._local()
        closed = local if self._file is None else local[:-1]
        # Without the segments whose files somebody has removed.
        self.waiting = tuple(one for one in closed if self.stored.file_of(one.number).exists())

    def _local(self) -> tuple[Segment, ...]:
        """The segments in the folder. Most are the last ones, because the segments of one owner move in order.

        A channel may have moved away and back before an earlier file has moved to the store. Does not look at all
        segments, because a channel may have very many.
        """
        found: list[Segment] = []
        least = len(self._segments) - self.stored.stored_objects
        for one in reversed(self._segments):
            if not self.stored.is_stored(one.number):
                found.append(one)
            elif len(found) >= least:
                break
        return tuple(reversed(found))

    def settle(self, packed: PackedSegment) -> tuple[Segment, ...]:
        """Note that a segment is in the store, and delete its file. Returns all segments. Raises OSError."""
        number = packed.segment.number
        if not self.is_left:
            self.stored.settle(packed)
            if all(one.number != number for one in self._segments):  # the limits have dropped it meanwhile
                self.stored.remove(number)
        return self._segments

    def close(self, stop: CleanStop | None) -> None:
        """See `SegmentFiles`."""
        super().close(stop)
        self._stop = None if stop is None else stop.at_end(self._segments, self._epoch)

    def name_of_stop(self) -> str | None:
        """The name of the object that notes a clean stop for the next owner; None unless the files are closed with a
        clean stop, and the store has all segments.
        """
        is_whole = self._stop is not None and not self.is_left and not self._local()
        return self.stored.name_of_stop(self._stop) if self._stop is not None and is_whole else None

    def leave(self) -> None:
        """Delete the folder of a channel that the host has given up, if it has no segments. Raises OSError."""
        if self.is_given_up and not self.is_left and not self.stored.numbers():
            self.stored.forget_known()
            with suppress(OSError):  # the folder has other files
                self._folder.rmdir()

    def find_again(self, found: Mapping[int, StoredSegment], archived_to: int) -> tuple[Segment, ...]:
        """Take over the segments of a listing that this host does not have. They came to the store after this host took
        the channel. After `open_unknown` they are all segments of the listing.

        `found`: the listing. `archived_to`: the next seq that this owner has to archive. All seqs below it are in the
        archive, or lost to it.
        Returns all segments. Raises OSError.
        """
        kept = {one.number: self._wide.get(one.number, one) for one in self._segments}
        latest = max(*kept, first_number(self._epoch)) if kept else 2**63
        self.is_listed = True
        self.former_stop = self.former_stop or self.stored.take_stop(self._epoch)
        self._unplaced += self.stored.adopt({number: one for number, one in found.items() if number not in kept})
        new = [one for one in self._unplaced if self.stored.is_stored(one.number)]
        if self.is_known:
            self.stored.note_more(new)
        else:
            self.stored.note(self._epoch)
            self.is_known = True
        for one in new:
            if one.number < latest and one.first_seq < archived_to:
                kept[one.number] = one
        ordered: list[Segment] = []
        repeated: list[int] = []  # segments whose items the next segment has
        following = max([archived_to, *(one.end_seq for one in self._segments)])
        for number in sorted(kept, reverse=True):
            segment = self._without(kept[number], following)
            if segment is not None:
                ordered.append(segment)
                following = segment.begin
            elif kept[number].first_seq >= following:  # otherwise a block is damaged, and its file or object stays
                repeated.append(number)
        self._segments, self._earlier_to = tuple(reversed(ordered)), None
        self._unplaced.clear()
        self._wide.clear()
        # Only after `_segments` lacks them, because a read must not report a removed segment as lost.
        for number in repeated:
            self.stored.remove(number)
        return self._segments

    @property
    def segments(self) -> tuple[Segment, ...]:
        """All segments of the archive, as they are now."""
        return self._segments

    def lacks_items(self, archived_to: int) -> bool:
        """Whether segments may be missing: there is a hole between two segments, or after the last one, or all
        segments belong to this owner. `archived_to`: see `find_again`.
        """
        pairs = pairwise(self._segments)
        own = first_number(self._epoch)
        is_alone = not self._segments or self._segments[0].number >= own
        if is_alone or self._segments[-1].end_seq < archived_to:
            return True
        return any(given_between(before.end_seq, after.first_seq) for before, after in pairs)

    def lacks_former(self, archived_to: int) -> bool:
        """Whether the former owner may still move its last segment to the store: there is a hole before the first
        segment of this owner. `archived_to`: as for `lacks_items`.
        """
        own = first_number(self._epoch)
        begin = next((one.begin for one in self._segments if one.number >= own), archived_to)
        ends = [one.end_seq for one in self._segments if one.number < own]
        return given_between(max(ends, default=1), begin) > 0

    def local_bytes(self) -> int:
        """The bytes of the segments in the folder."""
        return sum(one.length for one in self._local())

    def check_same(self, packed: PackedSegment) -> None:
        """Check that the store has the object of this segment, by its name and length. Raises OSError. Thread-safe."""
        if not self.stored.has_object(packed.name, len(packed.content)):
            text = (
                f"the store does not have the object {packed.name} with {len(packed.content)} bytes; if it exists, "
                "move it away, and find out which program wrote it"
            )
            raise OSError(errno.EEXIST, text)
