"""Puts of a channel that moves: they wait, and a run that is accepted in part goes on at the next owner."""

from __future__ import annotations

from stampede_rt.errors import error_for
from stampede_rt.values.model import Policy
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.puts import ChannelPuts
from stampede_rt_channel_host.core.channel import ChannelCore, run_to_end
from stampede_rt_channel_host.core.run_outcome import RunOutcome

NOW = 1000


def puts_of(channel: ChannelCore) -> ChannelPuts:
    return ChannelPuts(channel, MemoryBudget(2**20), lambda: NOW, lambda now: None, lambda: None)


def run_of(items: int, wait_nanos: int | None = None) -> IncomingRun:
    times = [NOW + at for at in range(items)]
    run = IncomingRun(encode_run([b"x"] * items, times=times), producer_id=7, first_number=1, wait_nanos=wait_nanos)
    run.keep()
    return run


def a_channel(max_items: int) -> ChannelCore:
    return ChannelCore(Policy(max_items=max_items, on_full="block", consumers=1), incarnation=7)


async def test_a_partly_accepted_run_continues_at_the_next_owner() -> None:
    source = puts_of(a_channel(3))
    waiting = run_of(4)
    assert source.put(waiting, NOW) is None
    source.hold()
    run_to_end(source.ending(error_for("MOVED", "the channel has moved", {})))
    assert waiting.ack is not None
    assert waiting.ack.HasField("error")
    larger = a_channel(10)
    destination = puts_of(larger)
    larger.put(run_of(3).offer, NOW, lambda first_seq, kept, stamped: b"body")  # the items that the feed has brought
    destination.retries = source.retries
    ack = destination.put(run_of(4), NOW)
    assert ack is not None
    assert (ack.first_seq, ack.items, larger.next_seq) == (1, 4, 5)


async def test_even_a_put_without_a_wait_is_held_during_a_move_and_accepted_after_it() -> None:
    channel = a_channel(10)
    puts = puts_of(channel)
    puts.hold()
    run = run_of(2, wait_nanos=0)
    assert puts.may_wait
    assert puts.put(run, NOW) is None
    puts.give_up(run)
    assert (run.ack, channel.next_seq) == (None, 1)
    puts.release()
    assert run.ack is not None
    assert (run.ack.first_seq, channel.next_seq) == (1, 3)


async def test_after_a_move_a_full_channel_refuses_a_put_whose_wait_is_over() -> None:
    puts = puts_of(a_channel(1))
    puts.hold()
    run = run_of(2, wait_nanos=0)
    puts.put(run, NOW)
    puts.give_up(run)
    puts.release()
    assert run.ack is not None
    assert [one.index for one in run.ack.rejections] == [1]


def test_the_retry_window_has_a_run_without_a_wait_before_its_first_items_are_announced() -> None:
    """In an earlier version, a replica got the first items of such a run, and learned of the run only with the next
    change.
    """
    known = list[RunOutcome | None]()

    def announced(now: int) -> None:
        known.append(puts.retries.find(7, 1, 4, now))

    puts = ChannelPuts(a_channel(3), MemoryBudget(2**20), lambda: NOW, announced, lambda: None)
    ack = puts.put(run_of(4, wait_nanos=0), NOW)
    assert ack is not None
    assert (ack.first_seq, [one.index for one in ack.rejections]) == (1, [3])
    assert [outcome is not None and outcome.is_whole for outcome in known] == [True]


def test_the_retry_window_has_a_waiting_run_before_its_first_items_are_announced() -> None:
    """In an earlier version, a replica got the first items without the run. A later owner accepted them again."""
    known = list[RunOutcome | None]()

    def announced(now: int) -> None:
        known.append(puts.retries.find(7, 1, 4, now))

    puts = ChannelPuts(a_channel(3), MemoryBudget(2**20), lambda: NOW, announced, lambda: None)
    run = run_of(4)
    assert puts.put(run, NOW) is None
    assert [outcome and (outcome.judged_items, outcome.end_seq) for outcome in known] == [(3, 4)]
    puts.give_up(run)
    (kept,) = puts.retries.kept(NOW)
    assert kept.outcome.is_whole
