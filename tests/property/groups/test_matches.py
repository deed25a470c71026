"""Items that come one by one get the same matches as all items together, even if streams break at any moment."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore, Offer
from stampede_rt_channel_host.core.group import OWN, LocalTrack, Matcher, OwnChannelTimes, RemoteTrack, Track
from tests.oracle.pairs import ItemKey, paired

NOW, FAR = 10_000, 5_000
OTHER = b"other"


class Replay:
    """Two channels whose items come one after the other, and matches of the first channel with the second."""

    def __init__(self, tolerance: int, lateness: int, *, unique: bool, is_far: bool) -> None:
        policy = Policy(max_items=1000)
        self.own, self.other = (ChannelCore(policy, incarnation=1, name=name) for name in ("own", "other"))
        self.tolerance, self.lateness, self.unique = tolerance, lateness, unique
        self.remote = RemoteTrack() if is_far else None
        self.times = {OWN: OwnChannelTimes(self.own, NOW), OTHER: OwnChannelTimes(self.other, NOW)}
        self.placed: dict[bytes, list[ItemKey]] = {OWN: [], OTHER: []}
        self.found: dict[ItemKey, ItemKey] = {}
        self.dropped = 0
        self.matcher = Matcher(self.own, self.tracks, tolerance, NOW, partners={} if unique else None)

    @property
    def tracks(self) -> dict[bytes, Track]:
        return {OTHER: self.remote or LocalTrack(self.other)}

    def put(self, name: bytes, time: int) -> None:
        channel = self.own if name == OWN else self.other
        key = time, channel.next_seq
        channel.put(Offer(times=[time], durations=None, lengths=[1]), NOW, lambda first_seq, kept, stamped: b".")
        self.placed[name].append(key)
        if name == OTHER and self.remote is not None:
            self.remote.add([key])

    def take(self) -> None:
        for name, one in self.times.items():
            one.observe(NOW)
            assert name in self.placed
        for one in self.matcher.take(self.has_passed, NOW, 1000):
            key = one.item.slice.first_time, one.item.slice.first_seq
            assert key not in self.found
            if OTHER in one.matched:
                self.found[key] = one.matched[OTHER][:2]

    def has_passed(self, name: bytes, instant: int) -> bool:
        return self.times[name].times(1).has_passed(instant, self.lateness)

    def resume(self) -> None:
        """Continue at another host, which knows only the cursor."""
        self.dropped += self.matcher.dropped
        partners = dict(self.matcher.partners) if self.unique else None
        position, next_seq = self.matcher.position, self.matcher.next_seq
        self.matcher = Matcher(self.own, self.tracks, self.tolerance, NOW, position, next_seq, partners)

    def end(self) -> None:
        for channel in (self.own, self.other):
            channel.advance(FAR, NOW)
        self.take()


TIMES = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 9)), max_size=14)


@settings(max_examples=400, deadline=None)
@given(TIMES, TIMES, st.integers(0, 12), st.sampled_from([0, 3, 9]), st.integers(0, 2**32))
@pytest.mark.parametrize("unique", [True, False])
def test_items_out_of_order_by_no_more_than_the_lateness_are_matched_as_if_all_were_known(
    unique: bool,
    own: Sequence[tuple[int, int]], other: Sequence[tuple[int, int]], tolerance: int, lateness: int, seed: int,
) -> None:  # fmt: skip
    rng = random.Random(seed)
    replay = Replay(tolerance, lateness, unique=unique, is_far=bool(rng.randrange(2)))
    times_left = {
        name: [time for time, _ in sorted(items, key=lambda one: one[0] + min(one[1], lateness))]
        for name, items in ((OWN, own), (OTHER, other))
    }
    if not lateness:  # a second item at the time of the newest one would then be late
        times_left = {name: [*dict.fromkeys(times)] for name, times in times_left.items()}
    while any(times_left.values()):
        name = rng.choice([one for one, left in times_left.items() if left])
        replay.put(name, times_left[name].pop(0))
        if rng.randrange(2):
            replay.take()
        if not rng.randrange(4):
            replay.resume()
    replay.end()
    owns, others = sorted(replay.placed[OWN]), sorted(replay.placed[OTHER])
    assert replay.found == (paired if unique else nearest)(owns, others, tolerance)
    assert replay.dropped + replay.matcher.dropped == 0


def nearest(own: Sequence[ItemKey], other: Sequence[ItemKey], tolerance: int) -> dict[ItemKey, ItemKey]:
    """For each item of `own` the nearest item of `other`, within `tolerance`. Several items may get the same item."""
    near = {one: min(other, key=lambda two: (abs(one[0] - two[0]), two), default=None) for one in own}
    return {one: two for one, two in near.items() if two is not None and abs(one[0] - two[0]) <= tolerance}
