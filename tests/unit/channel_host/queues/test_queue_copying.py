"""The steps of a queue that its owner keeps for the next owner."""

from __future__ import annotations

from stampede_rt_channel_host.core.channel import run_to_end
from stampede_rt_channel_host.core.queue.queue_snapshot import MESSAGES_PER_PIECE
from stampede_rt_channel_host.queues.queue_copying import QueueCopying
from tests.support.channel_host.queue_cores import Core


def test_the_owner_keeps_only_the_steps_after_the_snapshot_which_has_the_earlier_ones() -> None:
    """In an earlier version, the earlier ones took memory, too, so the queue of a busy producer did not move."""
    core = Core(max_items=10 * MESSAGES_PER_PIECE)
    core.put(*[1] * 4 * MESSAGES_PER_PIECE)
    core.taker(1, 4 * MESSAGES_PER_PIECE)
    while core.dispatched():
        core.queue.tick(core.now)
    copying, puts = QueueCopying(core.queue, None), 0

    def note() -> int:
        nonlocal puts
        core.put(1)
        puts += 1
        copying.changed(core.now)
        assert not copying.steps.size_bytes
        return core.now

    snapshot = run_to_end(copying.snapshot(note))
    assert puts > 4
    (held,) = snapshot.held
    assert held.last == 4 * MESSAGES_PER_PIECE + puts
    core.put(1)
    copying.changed(core.now)
    (step,) = copying.steps.take(10, 2**20)
    assert step.number == snapshot.next_step


def test_a_copy_without_a_snapshot_ends() -> None:
    core = Core()
    run_to_end(QueueCopying(core.queue, None).ending())
    assert core.queue._queue_items.changes is None
