"""A feed without the owner's facts: the run that the source has stored last, as the next part."""

from __future__ import annotations

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore, ChannelFeed, FedChannel, NewFloor, Offer

NOW = 1000


def put(core: ChannelCore, *times: int) -> None:
    offer = Offer(times=times, durations=None, lengths=[8] * len(times))
    assert core.put(offer, NOW, lambda *_: b"body").run is not None


@pytest.fixture
def core() -> ChannelCore:
    """A channel that has collected items."""
    core = ChannelCore(Policy(max_items=2, max_future_nanos=1000), incarnation=1)
    for time in (1, 2, 3, 4):
        put(core, time)
    return core


@pytest.fixture
def feed(core: ChannelCore) -> ChannelFeed:
    """A feed whose copy has everything."""
    feed = ChannelFeed(core, None, NOW)
    while feed.take(NOW, 10**6) is not None:
        pass
    return feed


def test_a_copy_tells_readers_of_its_ring_that_the_owner_has_an_archive() -> None:
    assert FedChannel(Policy(max_items=2, archive_nanos=10**9), incarnation=1).ring_facts().is_recorded
    assert not FedChannel(Policy(max_items=2), incarnation=1).ring_facts().is_recorded


def test_the_last_run_comes_with_the_items_that_have_left_because_of_it(core: ChannelCore, feed: ChannelFeed) -> None:
    put(core, 5)
    fed = feed.take_newest(10**6)
    assert fed is not None
    assert (fed.item.seq, fed.item.time, fed.item.duration, fed.item.length, fed.item.body) == (5, 5, -1, 8, b"body")
    assert fed.collected == NewFloor((3, 4), 3, 4)
    assert feed.next_seq == 6
    assert feed.take_newest(10**6) is feed.take(NOW, 10**6) is None


OTHER_FACTS = {
    "floor_resets": 1, "last_cause": "age", "collected_by": "age", "newest_consumed": 1, "frontier_max": 1,
    "passed_seqs": 1,
}  # fmt: skip


@pytest.mark.parametrize("fact", OTHER_FACTS)
def test_the_last_run_comes_in_a_part_if_the_copy_lacks_another_fact(
    core: ChannelCore, feed: ChannelFeed, fact: str
) -> None:
    put(core, 5)
    setattr(core.held, fact, OTHER_FACTS[fact])
    assert feed.take_newest(10**6) is None
    part = feed.take(NOW, 10**6)
    assert part is not None
    assert len(part.slices) == 1


@pytest.mark.parametrize("case", ["two runs", "a run above the limit", "nothing", "no credit"])
def test_take_newest_does_not_move_the_feed_if_it_returns_nothing(
    core: ChannelCore, feed: ChannelFeed, case: str
) -> None:
    if case == "two runs":
        put(core, 5)
    if case != "nothing":
        put(core, *((6,) if case == "no credit" else (6, 7)))
    assert feed.take_newest({"a run above the limit": 143, "no credit": 0}.get(case, 144)) is None
    assert feed.next_seq == 5
    assert (feed.take_newest(144) is None) == (case in ("two runs", "nothing"))
