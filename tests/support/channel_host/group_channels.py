"""Small channels for groups."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, Slice

INCARNATION = 7
NOW = 10_000


def channel(*times: int, durations: Sequence[int] | None = None, policy: Policy | None = None) -> ChannelCore:
    """Return a channel with an item at each time, each in its own put."""
    made = ChannelCore(policy or Policy(max_items=1000), incarnation=INCARNATION)
    for at, time in enumerate(times):
        put(made, time, None if durations is None else durations[at])
    return made


def put(into: ChannelCore, time: int, duration: int | None = None) -> None:
    offer = Offer(times=[time], durations=None if duration is None else [duration], lengths=[8])
    assert into.put(offer, NOW, lambda first_seq, kept, stamped: b"body").run is not None


def times(slices: Sequence[Slice]) -> list[int]:
    return [time for part in slices for time in part.run.times[part.lo : part.hi]]
