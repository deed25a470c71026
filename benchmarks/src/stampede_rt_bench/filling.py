"""Fills channels with many items: channels of the pure core, as a host has them, and channels of a cluster."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import repeat

import stampede_rt as st
from stampede_rt.values.model import Policy
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_bench.measuring import PAYLOAD_BYTES
from stampede_rt_channel_host.core.channel import ChannelCore, Offer

PERIOD_NANOS = 1_000_000
FIRST_NANOS = 1_700_000_000_000_000_000
REMOTE_PERIOD_NANOS = 1000
BYTES_MAX = 1 << 40
REMOTE_BYTES_MAX = 1 << 33


def time_of(index: int) -> int:
    """Return the time of the item with this index."""
    return FIRST_NANOS + index * PERIOD_NANOS


def filled_channel(items: int, *, run_items: int = 1) -> ChannelCore:
    """Return a channel with `items` items of 64 B, in runs of `run_items`, as producers would put them."""
    channel = ChannelCore(Policy(max_items=items, max_bytes=BYTES_MAX), incarnation=1, name="bench")
    for first in range(0, items, run_items):
        put_run(channel, range(first, min(first + run_items, items)))
    return channel


def filled_remote_channel(rt: st.Connection, items: int) -> st.Channel:
    """Return a channel of a cluster with `items` items of 64 B, REMOTE_PERIOD_NANOS apart.

    The newest item has about the present time.
    """
    channel = rt.channel(f"bench/{items}", max_items=items, max_bytes=REMOTE_BYTES_MAX)
    first = st.now() - items * REMOTE_PERIOD_NANOS
    payload = bytes(PAYLOAD_BYTES)
    with channel.producer() as producer:
        for place in range(items):
            producer.put(payload, time=first + place * REMOTE_PERIOD_NANOS)
    return channel


def filled_embedded_channel(rt: st.Connection, items: int) -> tuple[st.Channel, st.Item]:
    """Return a channel at the host in this process, filled as in `filled_remote_channel`, and its item in the middle.

    A producer puts all other items in runs. A single put brings the item in the middle, so reads return its payload by
    reference.
    """
    channel = rt.channel(f"bench/embedded/{items}", max_items=items, max_bytes=REMOTE_BYTES_MAX)
    first = st.now() - items * REMOTE_PERIOD_NANOS
    payload, half = bytes(PAYLOAD_BYTES), items // 2
    with channel.producer() as producer:
        for place in range(half):
            producer.put(payload, time=first + place * REMOTE_PERIOD_NANOS)
    middle = channel.put(payload, time=first + half * REMOTE_PERIOD_NANOS)
    with channel.producer() as producer:
        for place in range(half + 1, items):
            producer.put(payload, time=first + place * REMOTE_PERIOD_NANOS)
    return channel, middle


def put_run(channel: ChannelCore, places: range) -> None:
    """Put one run with the items at these places. Raises AssertionError if the channel does not accept all of them."""
    times = [time_of(place) for place in places]
    raw = encode_run([bytes(PAYLOAD_BYTES) for _ in places], times=times)

    def seal(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
        return seal_run(raw, first_seq)

    offer = Offer(times=times, durations=None, lengths=list(repeat(PAYLOAD_BYTES, len(times))))
    outcome = channel.put(offer, times[-1], seal)
    if outcome.run is None or outcome.rejections or outcome.waiting is not None:
        raise AssertionError(f"the channel did not take items {places}: {outcome}")
