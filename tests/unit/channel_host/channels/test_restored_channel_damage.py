"""Reads of a restarted channel whose archive has a flipped bit: each read that lacks an item says LOST."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt.ring.newest import find_newest
from stampede_rt.ring.ring_view import RingView
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import NOW, OLDEST, Bound, Interval, Match
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_channel_host.archive.written_parts import MissingSeqs
from stampede_rt_channel_host.channels.restored_channel import restore_channel
from stampede_rt_channel_host.core.archive import (
    ArchivedRead,
    ArchivedRun,
    Segment,
    WantedItems,
    WantedWindow,
    reaches,
    resolved,
    span_of,
)
from stampede_rt_channel_host.core.channel import (
    FIRST_KEY,
    ITEM_OVERHEAD_BYTES,
    ChannelCore,
    Offer,
    Query,
    ReadAnswer,
    run_to_end,
)
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY
from stampede_rt_channel_host.core.ring_writer import ClockReading, RingWriter, ring_size
from tests.unit.channel_host.archive.test_archive_files import NO_LIMITS, decode, opened, run_at, write

CLOCK = 1000
LAST = 12  # the seq and the time of the last item


class RestartedChannel:
    """A channel of a host that has started with this folder."""

    def __init__(self, folder: Path, restored_bytes: int = 2**20, policy: Policy | None = None) -> None:
        self.files = SegmentFiles(folder, {})
        self.found = self.files.open(2, 7)
        self.segments: tuple[Segment, ...] = self.found.segments
        self.channel = ChannelCore(policy or Policy(max_items=100), incarnation=7)
        wanted = WantedItems(FIRST_KEY[0], LAST_KEY, 0, restored_bytes, down=True)
        newest = self.files.load(self.segments, WantedWindow(wanted, FIRST_KEY, LAST_KEY), decode, lambda: None)
        restore_channel(self.channel, self.found, newest, lambda body, lo, hi: body)

    def read(self, start: int, end: int, *, newest_first: bool = False) -> ReadAnswer:
        """The answer of a get: from memory if that is enough, as the host decides it."""
        query = Query(
            interval=Interval(Bound(None, start), Bound(None, end)), match=Match.START, newest_first=newest_first
        )
        moment, span = self.channel.snapshot(CLOCK), span_of(self.segments)
        within = resolved(moment, span, query)
        assert within is not None
        if not self.segments or not reaches(moment.look(0)[0], start):
            return self.channel.read(query, CLOCK)
        read = ArchivedRead(moment, span, query, within)
        run_to_end(read.begin())
        while (wanted := read.next_window()) is not None:
            run_to_end(read.take(self.files.load(self.segments, wanted, decode, lambda: None)))
        return read.answer()


def seqs(answer: ReadAnswer) -> set[int]:
    return {part.first_seq + at for part in answer.slices for at in range(part.items)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of an archive with six blocks of two items, after a clean stop."""
    files, _ = opened(tmp_path / "c")
    write(files, 1, LAST // 2)
    files.close(CleanStop(7, epoch=2))
    [found] = (tmp_path / "c").glob("*.segment")
    return found


def flips(former: bytes) -> Iterator[bytes]:
    """The file with one flipped bit, at many places."""
    for at in range(0, len(former), 3):
        flipped = bytearray(former)
        flipped[at] ^= 1 << at % 8
        yield bytes(flipped)


def check(host: RestartedChannel, last: int) -> None:
    """Check that a read that lacks items up to the seq `last` says so, whatever its interval and direction."""
    assert last - len(seqs(host.read(0, last + 1))) in (0, 2), "a flipped bit costs one block"
    for start in range(0, last + 1, 2):
        for end, newest_first in ((start + 1, False), (last, False), (last, True)):
            answer = host.read(start, end, newest_first=newest_first)
            missing = set(range(max(1, start), min(end, last) + 1)) - seqs(answer)
            assert not missing or answer.reason == "LOST", (start, end, missing, answer.reason)


@pytest.mark.parametrize("restored_bytes", [1, 300, 2**20])
def test_each_read_that_lacks_items_of_a_damaged_block_says_so(path: Path, restored_bytes: int) -> None:
    former, note = path.read_bytes(), path.with_name("stopped-cleanly").read_bytes()
    for flipped in flips(former):
        path.write_bytes(flipped)
        path.with_name("stopped-cleanly").write_bytes(note)
        host = RestartedChannel(path.parent, restored_bytes)
        assert (host.found.damaged_blocks, host.found.torn_bytes) == (1, 0)
        assert host.channel.next_seq == LAST + 1, "no later item gets the seq of a lost one"
        check(host, LAST)


def test_a_damaged_block_stays_a_loss_when_later_items_and_another_stop_have_come(path: Path) -> None:
    former, note = path.read_bytes(), path.with_name("stopped-cleanly").read_bytes()
    for flipped in [*flips(former)][::3]:
        path.write_bytes(flipped)
        path.with_name("stopped-cleanly").write_bytes(note)
        first = RestartedChannel(path.parent)
        write(first.files, LAST + 1, 1)
        first.files.close(
            CleanStop(7, epoch=2, lost_from=first.channel.lost_from, lost_before=first.channel.lost_before)
        )
        check(RestartedChannel(path.parent), LAST + 2)
        for later in {*path.parent.glob("*.segment")} - {path}:
            later.unlink()


def test_an_item_with_the_time_of_the_last_archived_items_hides_none_of_them(path: Path) -> None:
    host = RestartedChannel(path.parent, restored_bytes=1)
    held, _ = host.channel.look(CLOCK)
    edge = held.newest_collected
    assert edge is not None
    offer = Offer(times=[edge], durations=None, lengths=[1])
    assert host.channel.put(offer, CLOCK, lambda first_seq, kept, stamped: b"13 ").run is not None
    assert seqs(host.read(0, LAST)) == {*range(1, LAST + 2)}
    assert seqs(host.read(edge, edge)) == {edge, LAST + 1}


def test_a_channel_whose_items_have_times_before_a_loss_takes_and_shows_later_items(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    write(files, 1, 2)
    files.close(None)
    files, _ = opened(tmp_path)
    lost_before = 500  # the host was lost at 500, and the items after it have the times 5 and 6
    files.write([MissingSeqs(5, 5, lost_before), [ArchivedRun(600, run_at(5))]], NO_LIMITS)
    files.close(CleanStop(7, lost_from=4, lost_before=lost_before, epoch=2))
    host = RestartedChannel(tmp_path)
    kept = host.channel.put(Offer(times=[7], durations=None, lengths=[1]), CLOCK, lambda *_: b"7")
    assert kept.run is not None
    newest = Query(interval=Interval(OLDEST, NOW), newest_first=True, limit=1)
    assert seqs(host.channel.read(newest, CLOCK)) == {7}
    assert seqs(host.read(0, 7)) == {*range(1, 8)}
    assert [host.read(start, 7).reason for start in range(1, 8)] == ["LOST"] * 7


def test_a_ring_asks_the_host_for_the_newest_item_if_only_the_archive_has_items(tmp_path: Path) -> None:
    files, _ = opened(tmp_path)
    write(files, 1, 2)
    files.close(None)
    files, _ = opened(tmp_path)
    files.write([MissingSeqs(5, 5, 500), [ArchivedRun(600, run_at(5))]], NO_LIMITS)
    files.close(CleanStop(7, lost_from=4, lost_before=500, epoch=2))
    channel = RestartedChannel(tmp_path).channel
    channel.record(channel.next_seq)
    facts, size = channel.ring_facts(), ring_size(2**12)
    memory = memoryview(bytearray(size.whole_bytes))
    writer = RingWriter(memory, size, 7, channel.newest)
    writer.publish(facts, ClockReading(0, 0, 0))
    view = RingView(memory.toreadonly())
    found = view.facts()
    assert found is not None
    assert find_newest(view, found) is True


@pytest.mark.parametrize("policy", [Policy(max_items=5), Policy(max_bytes=5 * (7 + ITEM_OVERHEAD_BYTES))])
def test_a_restarted_channel_keeps_only_as_many_items_in_memory_as_its_limits_allow(path: Path, policy: Policy) -> None:
    restarted = RestartedChannel(path.parent, policy=policy)
    counters = restarted.channel.counters(CLOCK)
    assert (counters.held, counters.accepted, sum(counters.collected.values())) == (5, LAST, LAST - 5)
    assert seqs(restarted.channel.read(Query(interval=Interval(OLDEST, NOW)), CLOCK)) == {*range(8, LAST + 1)}
    assert seqs(restarted.read(1, LAST)) == {*range(1, LAST + 1)}
    assert restarted.read(1, LAST).reason is None
