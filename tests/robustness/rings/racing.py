"""A ring with a writer without pauses, and readers that check each item: `python -m ...rings.racing SECONDS`.

The ring is small, so the writer reclaims the bytes of a run while readers copy it. Each payload has a checksum, the seq
and the time of its item. A reader fails for a torn, recycled or reordered item.
"""

from __future__ import annotations

import mmap
import multiprocessing
import random
import sys
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from multiprocessing.synchronize import Event
from typing import Any

from stampede_rt.ring.layout import RingSize
from stampede_rt.ring.newest import FoundNewest, find_newest
from stampede_rt.ring.ring_view import RingView
from stampede_rt.ring.selecting import Columns, select
from stampede_rt.ring.successors import FoundNext, find_next
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import Bound, Interval
from stampede_rt_channel_host.core.ring_writer import ClockReading, RingFacts, RingRun, RingWriter

SIZE = RingSize(16, 64 * 1024)
STEP_NANOS = 10
_HEAD_BYTES = 20


def body_of(seq: int, filling: bytes) -> bytes:
    """An encoded run of one item, with a checksum over itself."""
    head = seq.to_bytes(8, "little") + (seq * STEP_NANOS).to_bytes(8, "little")
    return head + zlib.crc32(filling, zlib.crc32(head)).to_bytes(4, "little") + filling


def seq_in(body: bytes) -> int:
    """The seq of a run. Fails if the run is torn."""
    head, checksum, filling = body[:16], body[16:_HEAD_BYTES], body[_HEAD_BYTES:]
    assert zlib.crc32(filling, zlib.crc32(head)).to_bytes(4, "little") == checksum, "a torn item"
    seq = int.from_bytes(head[:8], "little")
    assert int.from_bytes(head[8:], "little") == seq * STEP_NANOS, "an item of another time"
    return seq


def write_on(memory: mmap.mmap, ends: Event, seed: int) -> None:
    """Append runs of all lengths until `ends` is set."""
    writer, drawn, seq = RingWriter(memoryview(memory), SIZE, 7, None), random.Random(seed), 0
    fillings = [drawn.randbytes(drawn.randrange(1, SIZE.data_bytes // 5)) for _ in range(64)]
    writer.set_fence(2**62)
    while not ends.is_set():
        for _ in range(200):
            seq += 1
            body, at = body_of(seq, drawn.choice(fillings)), seq * STEP_NANOS
            writer.append(RingRun(seq, 1, at, at, body, -1, len(body) << 16))
            facts = RingFacts(seq + 1, True, None, None, (-(2**63), 0), None, False)
            writer.publish(facts, ClockReading(0, at, 0))


def no_columns(body: bytes) -> Columns:
    raise AssertionError("the writer never wrote a run of several items")


def read_on(memory: mmap.mmap, ends: Event, found: Any) -> None:
    """Read in all ways until `ends` is set. Reports the number of items that each way has given."""
    counts: Counter[str] = Counter()
    while not ends.is_set():
        try:
            view = RingView(memoryview(memory).toreadonly())
        except Exception:  # noqa: BLE001  # the writer has not begun
            continue
        for way, seq in _items(view, ends):
            counts[way] += seq > 0
            counts[f"{way} asks"] += seq == 0
    found.put(counts)


def _items(view: RingView, ends: Event) -> Iterator[tuple[str, int]]:
    last_newest, next_seq, slot = 0, 1, -1
    while not ends.is_set():
        facts = view.facts()
        if facts is None:
            continue
        newest = find_newest(view, facts)
        if isinstance(newest, FoundNewest):
            seq = seq_in(newest.body)
            assert seq == newest.slot.seq, "a recycled item"
            assert seq >= last_newest, "the newest item went back"
            last_newest = seq
        yield "newest", last_newest if isinstance(newest, FoundNewest) else 0
        item = find_next(view, facts, next_seq, slot, 0, no_columns)
        if isinstance(item, FoundNext):
            assert seq_in(item.piece.body) == next_seq, "a skipped or reordered item"
            slot, next_seq = item.slot.number, item.end_seq
            yield "next", next_seq
        elif item:
            slot, next_seq = -1, max(last_newest - 3, 1)  # as a stream that has caught up
            yield "next", 0
        yield "interval", _read_interval(view, facts, last_newest)


def _read_interval(view: RingView, facts: list[int], newest: int) -> int:
    start, end = max(newest - 5, 1), max(newest - 2, 1)
    query = ReadQuery(Interval(Bound(None, start * STEP_NANOS), Bound(None, end * STEP_NANOS)))
    picked = select(view, facts, query, 0, no_columns)
    if picked is None:
        return 0
    seqs = [seq_in(piece.body) for piece in picked.pieces]
    assert seqs == [*range(start, end + 1)], "a wrong interval"
    return len(seqs)


def race(seconds: float, readers: int = 2, seed: int = 1) -> Counter[str]:
    """Race for this time. Returns the number of items that each way has given. Fails if any process failed."""
    context = multiprocessing.get_context("fork")
    memory, ends, found = mmap.mmap(-1, SIZE.whole_bytes), context.Event(), context.Queue()
    jobs = [context.Process(target=write_on, args=(memory, ends, seed))]
    jobs += [context.Process(target=read_on, args=(memory, ends, found)) for _ in range(readers)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12 warns about a fork of a process with threads
        for job in jobs:
            job.start()
    until = time.monotonic() + seconds
    while time.monotonic() < until and all(job.is_alive() for job in jobs):
        jobs[0].join(0.1)
    ends.set()
    counts: Counter[str] = Counter()
    for _ in range(readers):
        counts.update(found.get(timeout=20))
    for job in jobs:
        job.join(20)
    assert [job.exitcode for job in jobs] == [0] * len(jobs), "a reader or the writer failed"
    return counts


if __name__ == "__main__":
    print(dict(race(float(sys.argv[1]), readers=2, seed=int(time.time()))))
