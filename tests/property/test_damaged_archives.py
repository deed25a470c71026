"""Random recorded channels with gaps, damaged files and late items: a read that lacks an item says LOST.

No read of a channel without gaps and damage says LOST.

`STAMPEDE_PROPERTY_EXAMPLES` sets the number of channels.
"""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import NamedTuple

import pytest

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, Interval, Match
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.archive.written_parts import MissingSeqs
from stampede_rt_channel_host.core.archive import (
    ArchivedRead,
    ArchivedRun,
    PastArchive,
    PastFacts,
    archived_read,
    is_nothing_left,
    nothing_left,
    past_moment,
    read_nothing,
    resolved,
    span_of,
)
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, Query, ReadAnswer, Run, make_run, run_to_end

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "60"))
READS, LATEST_EPOCH = 40, 9
NO_LIMITS = ArchiveLimits(None, None)


class Put(NamedTuple):
    """An item that the host has accepted."""

    time: int
    accepted: int


def run_of(first_seq: int, times: list[int]) -> Run:
    body = b"%d|%s|" % (first_seq, b",".join(b"%d" % one for one in times))
    return make_run(first_seq, times, None, [7] * len(times), body)


def decode(body: bytes) -> Run:
    first_seq, times = body.split(b"|")[:2]
    return run_of(int(first_seq), [int(one) for one in times.split(b",")])


class History:
    """A recorded channel from its first item on.

    The order of use: `write`, `damage`, `open`, then `read` and `lost_ranges`.

    `items`: all accepted items, by their seqs.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.dice = folder, random.Random(seed)
        dice = self.dice
        self._late, self._early = dice.choice([(0, 0), (6, 0), (6, 3), (40, 3)])
        limit = dice.choice([{}, {"max_items": dice.randint(1, 12)}, {"max_age_nanos": dice.randint(1, 12)}])
        self.policy = Policy(**{"max_items": 100, **limit}, max_future_nanos=self._early)
        self._host = ChannelCore(self.policy, incarnation=7)
        self.now = 10
        self.items: dict[int, Put] = {}
        self.loss: tuple[int | None, int | None] = (None, None)
        self.is_whole = True

    def write(self) -> None:
        """Write the items as several owners, one after the other. Each of them stops cleanly."""
        for epoch in range(2, 2 + self.dice.randint(1, 4)):
            files = SegmentFiles(self.folder, {})
            files.open(epoch)
            for _ in range(self.dice.randint(1, 4)):
                runs = [one for one in (self._put() for _ in range(self.dice.randint(1, 3))) if one is not None]
                if runs and self.dice.random() < 0.15:  # max_bytes has collected them
                    last, self.is_whole = runs[-1].run, False
                    files.write([MissingSeqs(runs[0].run.first_seq, last.first_seq + len(last))], NO_LIMITS)
                elif runs:
                    files.write([runs], NO_LIMITS)
            files.close(CleanStop(7, epoch=epoch))

    def _put(self) -> ArchivedRun | None:
        self.now += self.dice.choice([1, 1, 1, 3, 20])
        times = [self.now - self._shift() for _ in range(self.dice.randint(1, 3))]
        offer = Offer(times=times, durations=None, lengths=[7] * len(times))
        run = self._host.put(offer, self.now, lambda first_seq, kept, stamped: b"").run
        self._host.collect(self.now)
        if run is None:
            return None
        for at, time in enumerate(run.times):
            self.items[run.first_seq + at] = Put(time, self.now)
        return ArchivedRun(self.now, run_of(run.first_seq, [*run.times]))

    def _shift(self) -> int:
        if self.dice.random() < 0.6:
            return 0
        return self.dice.randint(-self._early, self._late)

    def damage(self) -> None:
        """Flip bits of contents or of anything, or leave nothing of a file."""
        paths = sorted(self.folder.glob("*.segment"))
        for _ in range(self.dice.randint(0, 2)):
            path, kind = self.dice.choice(paths), self.dice.randrange(3)
            self.is_whole = False
            raw = bytearray(path.read_bytes())
            contents = [at for at, one in enumerate(raw) if one == ord("|")]
            if kind == 0:
                raw = bytearray(len(raw))
            elif kind == 1 and contents:
                raw[self.dice.choice(contents)] ^= 1
            else:
                raw[self.dice.randrange(len(raw))] ^= 1 << self.dice.randrange(8)
            path.write_bytes(raw)

    def open(self) -> bool:
        """Open the archive before or after the damage. Returns whether it has any item."""
        after_damage = self.dice.random() < 0.5
        next_seq, newest = max(self.items, default=0) + 1, max((one.time for one in self.items.values()), default=0)
        files = SegmentFiles(self.folder, {})
        if not after_damage:
            self.segments = files.open(LATEST_EPOCH).segments
        self.damage()
        self.files = SegmentFiles(self.folder, {}) if not after_damage else files
        if after_damage:
            self.segments = files.open(LATEST_EPOCH).segments
        self.span = span_of(self.segments)
        if self.span.newest is None:
            return False
        self.end_seq = max(one.end_seq for one in self.segments)
        if self.end_seq < next_seq:  # a torn end: the next owner says LOST from the last archived item on
            since = min(self.span.newest, max(one.last_accepted for one in self.segments))
            self.loss = since, max(self.now, newest) + 1
        self.channel = ChannelCore(self.policy, incarnation=7)
        self.channel.restore((), after=max(newest, self.span.newest), next_seq=next_seq, loss=self.loss)
        return True

    def query(self) -> tuple[Query, int | None]:
        """A random read, and its `as_of`."""
        start = self.dice.randint(5, self.now + 2)
        end = self.dice.randint(start, min(self.now + 4, start + self.dice.choice([0, 3, 1000])))
        query = Query(
            interval=Interval(Bound(None, start), Bound(None, max(start, end))),
            match=Match.START,
            newest_first=self.dice.random() < 0.5,
            limit=self.dice.choice([None, None, 1, 2, 5]),
        )
        return query, self.dice.choice([None, self.dice.randint(8, self.now + 3)])

    def read(self, query: Query, as_of: int | None) -> ReadAnswer:
        """The answer, as a host makes it."""
        past: PastArchive | None = None
        moment, segments = self.channel.snapshot(10**6), self.segments
        since, before = self.loss
        if as_of is not None:
            past = self.files.past(segments, as_of, decode)
            segments = past.segments
            facts = PastFacts(self.policy, 7, past.advance, before, since)
            moment = past_moment(facts, past, span_of(segments), as_of)
        span = span_of(segments)
        within = resolved(moment, span, query)
        if past is not None and as_of is not None:
            if is_nothing_left(self.segments, past, has_dropped=self.span.has_dropped(before, since)):
                return nothing_left(self.segments, past, within, as_of, 7)
            if span.newest is None:
                return run_to_end(read_nothing(moment, query, within))
        assert within is not None
        one = ArchivedRead(moment, span, query, within)
        run_to_end(one.begin())
        while (wanted := one.next_window()) is not None:
            run_to_end(one.take(self.files.load(segments, wanted, decode, lambda: None, past)))
        return one.answer()

    def lost_ranges(self, query: Query, as_of: int | None, answer: ReadAnswer) -> list[tuple[int, int]]:
        """The items (time, seq) that the answer lacks. Checks that it has no others."""
        start, end = query.interval.start.offset, query.interval.end.offset
        known = {seq: one.time for seq, one in self.items.items() if as_of is None or one.accepted <= as_of}
        found = [part.first_seq + at for part in answer.slices for at in range(part.items)]
        assert len(found) == len({*found})
        assert all(start <= known[seq] <= end for seq in found)
        have = {(known[seq], seq) for seq in found}
        want = {(time, seq) for seq, time in known.items() if start <= time <= end}
        if answer.more and have:  # the limit has cut off the others
            want = {one for one in want if (one >= min(have) if query.newest_first else one <= max(have))}
        elif query.limit is not None and len(have) == query.limit:
            want = have
        return sorted(one for one in want - have if self._is_promised(*one))

    def _is_promised(self, time: int, seq: int) -> bool:
        """Whether a read must say that it lacks this item. A torn end says LOST only for times from the end on."""
        since, before = self.loss
        return seq < self.end_seq or (since is not None and before is not None and since <= time < before)


@pytest.mark.parametrize("seed", range(EXAMPLES))
def test_a_read_that_lacks_items_says_lost(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = History(tmp_path / "c", seed)
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", one.dice.choice([1, 300, 2**18]))
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", one.dice.choice([1, 300, 2**20]))
    one.write()
    if not one.open():
        return
    for _ in range(READS):
        query, as_of = one.query()
        answer = one.read(query, as_of)
        lost_ranges = one.lost_ranges(query, as_of, answer)
        # without the head of the first block the host does not know whether the limits have removed the first items
        reports_loss = answer.reason == "LOST" or (one.span.is_cut and answer.reason == "COLLECTED")
        assert not lost_ranges or reports_loss, (query, as_of, lost_ranges, answer.reason, seed)
        assert not one.is_whole or answer.reason != "LOST", (query, as_of, answer.reason, seed)
