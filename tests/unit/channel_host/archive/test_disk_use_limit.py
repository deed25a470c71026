"""The files of an archive stay within its limit, for all orders of puts, advances and late writes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt.errors import Overloaded
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.archive.disk_use import DiskUse, folders_of_channels
from stampede_rt_channel_host.archive.recorder import BYTES_PER_WRITE, ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES, ChannelCore, Offer

MIB = 2**20
LIMIT = 3 * MIB
MS = 10**6
Step = tuple[str, int, int]  # the kind of step, the channel, the bytes


class RecordedChannelRig:
    """A channel with its recorder. The recorder writes only when the test says so."""

    def __init__(self, disk: DiskUse, folder: Path, number: int, limits: ArchiveLimits) -> None:
        channel_id = bytes([number]) * 16
        self.files = SegmentFiles(folder / channel_id.hex(), {"channel": "cam", "created_by": "cam"})
        segments = self.files.open(1).segments
        self.core = ChannelCore(Policy(max_items=2, max_bytes=2 * MIB), incarnation=1)
        self.recorder = ChannelRecorder(self.core, self.files, segments, disk.of_channel(channel_id, "cam"))
        self.recorder.limit(limits)

    def put(self, size: int, now: int) -> bool:
        """Put an item of that size as a host does. Returns whether the archive has room for it."""
        try:
            self.recorder.check_room(size + ITEM_OVERHEAD_BYTES)
        except Overloaded:
            return False
        self.core.put(Offer(times=(now,), durations=None, lengths=(size,)), now, lambda *_: bytes(size))
        self.recorder.note(now)
        return True

    def advance(self, now: int) -> None:
        try:
            self.recorder.check_room()
        except Overloaded:
            return
        self.core.advance(now, now)
        self.recorder.note(now)

    def write(self) -> None:
        """Write all waiting items in parts, as the archive does."""
        while (job := self.recorder.take()).parts:
            self.recorder.written(job, self.files.write(job.parts, self.recorder.limits))


def on_disk(folder: Path) -> int:
    return sum(one.bytes for one in folders_of_channels(folder))


steps = st.lists(
    st.tuples(
        st.sampled_from(("put", "put", "put", "advance", "write")),
        st.integers(0, 2),
        st.sampled_from((0, 100, 2**16, 2**18, MIB)),
    ),
    max_size=60,
)
own_limits = st.tuples(*[st.sampled_from((None, 1, 2**18, MIB))] * 3)
ages = st.sampled_from((None, 1, 10**9))


@given(steps, own_limits, ages)
def test_the_files_stay_within_the_limit(
    steps: Sequence[Step], own_limits: Sequence[int | None], age_nanos: int | None
) -> None:
    with TemporaryDirectory() as name:
        folder, disk = Path(name), DiskUse(LIMIT)
        channels = [
            RecordedChannelRig(disk, folder, one, ArchiveLimits(age_nanos, own_limits[one])) for one in range(3)
        ]
        for at, (what, which, size) in enumerate((*steps, ("write", 0, 0), ("write", 1, 0), ("write", 2, 0))):
            one, now = channels[which], (at + 1) * MS
            if what == "put":
                one.put(size, now)
            elif what == "advance":
                one.advance(now)
            else:
                one.write()
                empty = sum(1 for other in channels if not other.recorder.segments)
                assert on_disk(folder) <= LIMIT + empty * 2**18  # folders without items do not count
        assert disk.used_bytes <= LIMIT
        for one in channels:
            one.files.close(None)


def test_a_channel_at_its_own_limit_is_still_recorded_while_the_archive_is_full(tmp_path: Path) -> None:
    disk = DiskUse(LIMIT)
    ring, other = (
        RecordedChannelRig(disk, tmp_path, number, ArchiveLimits(None, own)) for number, own in ((0, MIB), (1, None))
    )
    for at in range(40):
        assert ring.put(2**16, at * MS)
        ring.write()
    at = 40
    while other.put(2**17, at * MS):
        other.write()
        at += 1
    for later in range(at, at + 40):
        assert ring.put(2**16, later * MS)
        ring.write()
    assert on_disk(tmp_path) <= LIMIT


def test_items_that_memory_drops_while_the_disk_fails_stop_counting(tmp_path: Path) -> None:
    disk = DiskUse(10 * BYTES_PER_WRITE)
    one = RecordedChannelRig(disk, tmp_path, 0, ArchiveLimits(None, None))
    for at in range(40 * BYTES_PER_WRITE // MIB):  # memory keeps one of them
        assert one.put(MIB, at * MS)
    assert disk.used_bytes <= BYTES_PER_WRITE + 3 * MIB


def test_a_channel_that_the_host_has_given_up_reserves_no_bytes(tmp_path: Path) -> None:
    disk = DiskUse(LIMIT)
    one = RecordedChannelRig(disk, tmp_path, 0, ArchiveLimits(None, None))
    assert one.put(MIB, MS)
    one.advance(2 * MS)
    one.recorder.stop()
    assert disk.used_bytes == 0
    with pytest.raises(Overloaded):
        one.recorder.check_room(LIMIT)
