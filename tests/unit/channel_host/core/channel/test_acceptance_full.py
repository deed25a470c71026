"""A put into a full channel calls at most a few times as many functions as a put into a channel with room."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from types import FrameType

import pytest

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore, Offer

S = 10**9
ROOM = Policy(max_items=10**6)
CALLS_MAX = 3.5  # times the calls of a put with room; in an earlier version it was 3.6 to 5.7


def nothing_sealed(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
    return b""


class Puts:
    """Puts items into one channel, in the order of time."""

    def __init__(self, policy: Policy, items: int) -> None:
        self._core = ChannelCore(policy, incarnation=1)
        self._items = items
        self._now = 1000 * S

    def put(self) -> None:
        self._now += S
        times = tuple(range(self._now, self._now + self._items))
        offer = Offer(times=times, durations=None, lengths=(64,) * self._items)
        assert self._core.put(offer, self._now + self._items, nothing_sealed).run is not None


def calls_of_a_put(policy: Policy, items: int) -> float:
    """The calls of Python functions that a put takes, on average over many puts after the channel is full."""
    puts, counted = Puts(policy, items), 0

    def count(frame: FrameType, event: str, argument: object) -> None:
        nonlocal counted
        counted += event == "call"

    for _ in range(200):
        puts.put()
    sys.setprofile(count)
    try:
        for _ in range(64):
            puts.put()
    finally:
        sys.setprofile(None)
    return counted / 64


@pytest.mark.parametrize(
    ("policy", "items"),
    [
        pytest.param(Policy(max_items=1), 1, id="only the newest item"),
        pytest.param(Policy(max_items=100), 1, id="max_items"),
        pytest.param(Policy(max_bytes=100 * 128), 1, id="max_bytes"),
        pytest.param(Policy(max_items=100, max_bytes=100 * 128), 1, id="both limits"),
        pytest.param(Policy(max_items=100, max_age_nanos=1000 * S), 1, id="max_items and max_age"),
        pytest.param(Policy(max_items=800), 8, id="runs of eight"),
    ],
)
def test_a_full_channel_multiplies_the_function_calls_of_a_put_by_at_most_a_small_factor(
    policy: Policy, items: int
) -> None:
    full, roomy = calls_of_a_put(policy, items), calls_of_a_put(ROOM, items)
    assert full < CALLS_MAX * roomy, f"{full:.0f} calls, and {roomy:.0f} with room"
