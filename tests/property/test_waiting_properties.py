"""A change of a channel, or of the cut of a group, releases each blocked get that it can release, whatever other gets
need.
"""

from __future__ import annotations

import contextlib
import os
import random
from collections.abc import Callable

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, Interval, Match, MetaTime
from stampede_rt_channel_host.core.channel import (
    AFTER_ALL,
    BEFORE_ALL,
    ChannelCore,
    Needs,
    Offer,
    PendingGet,
    Position,
    Query,
    Reach,
    ReachTracker,
    WakeAt,
)
from stampede_rt_channel_host.core.group import Horizon, VisibleChannel

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "300"))
POLICIES = (
    Policy(max_items=6, max_future_nanos=9),
    Policy(max_age_nanos=12, max_future_nanos=9),
    Policy(max_bytes=300, max_future_nanos=9),
    Policy(consumers=1, max_items=9, max_future_nanos=9),
    Policy(max_age_nanos=9, max_items=4, on_full="block", max_future_nanos=9),
)


class Scenario:
    """One channel, and blocked gets on the whole channel or on its items before a cut, which only grows."""

    def __init__(self, seed: int, policy: Policy, *, grouped: bool) -> None:
        self.rng = random.Random(seed)
        self.now = 1000
        self.channel = ChannelCore(policy, incarnation=1)
        self.grouped = grouped
        self.cut: int | None = None
        self.tracker = ReachTracker(self.channel)
        self.waiting: list[tuple[PendingGet, WakeAt]] = []
        self.policy = policy
        self.tracker.begin(self.visible_to)

    @property
    def visible_to(self) -> int:
        if not self.grouped:
            return AFTER_ALL
        return BEFORE_ALL if self.cut is None else self.cut

    def view(self) -> tuple[Callable[[Query], PendingGet], Callable[[PendingGet], object]]:
        if not self.grouped:
            return (lambda query: self.channel.begin(query, self.now)), lambda one: self.channel.poll(one, self.now)
        view, horizon = VisibleChannel(self.channel), Horizon(self.cut, str)
        return (
            lambda query: view.begin(query, horizon, self.now),
            lambda one: view.poll(one, horizon, self.now),
        )

    def bound(self) -> Bound:
        around = self.channel.newest or self.now
        kind = self.rng.randrange(6)
        if kind < 4:
            return Bound(None, self.rng.choice((around, self.now)) + self.rng.randint(-8, 9))
        meta = self.rng.choice((MetaTime.NOW, MetaTime.NEWEST, MetaTime.OLDEST))
        return Bound(meta, self.rng.randint(-3, 3))

    def block(self) -> None:
        begin, poll = self.view()
        around = self.channel.newest or self.now
        position = Position(around + self.rng.randint(-2, 1), self.rng.choice((None, self.channel.next_seq - 1)))
        start, end = self.bound(), self.bound()
        if start.meta is None and end.meta is None and start.offset > end.offset:
            start, end = end, start
        exclusive = self.rng.random() < 0.3, self.rng.random() < 0.5
        query = Query(
            interval=Interval(start, end, *exclusive),
            match=self.rng.choice(list(Match)),
            complete=self.rng.random() < 0.3,
            newer_than=position if self.rng.random() < 0.3 else None,
            newest_first=self.rng.random() < 0.3,
        )
        pending = begin(query)
        found = poll(pending)
        if isinstance(found, WakeAt):
            self.waiting.append((pending, found))

    def step(self) -> None:
        """Change something, and poll each get that the change may release."""
        kind = self.rng.randrange(8)
        around = self.rng.choice((self.channel.newest or self.now, self.now))
        if kind < 4:
            items = self.rng.choice((1, 1, 2, 4))
            times = [around + self.rng.randint(-7, 6) for _ in range(items)]
            durations = [self.rng.choice((-1, 0, 1, 4, 9)) for _ in range(items)]
            stamped = self.rng.random() < 0.2
            offer = Offer(times=None if stamped else times, durations=durations, lengths=[8] * items)
            self.channel.put(offer, self.now, lambda *_: b"")
        elif kind == 4:
            self._refused(lambda: self.channel.advance(around + self.rng.randint(-3, 5), self.now))
        elif kind == 5 and self.policy.consumers:
            seqs = range(max(1, self.channel.next_seq - 6), self.channel.next_seq)
            self._refused(lambda: self.channel.consume(7, [*seqs], self.now))
        elif kind == 6:
            self.channel.configure(self.rng.choice(POLICIES), self.now)
            self.channel.configure(self.policy, self.now)
        if self.grouped and self.rng.random() < 0.4:
            self.cut = max(self.cut or 0, around + self.rng.randint(-6, 6))
        self.look()

    def _refused(self, step: Callable[[], object]) -> None:
        with contextlib.suppress(StampedeError):
            step()

    def look(self) -> None:
        """Check that the gets outside of the reach of the change are not released by it."""
        _, poll = self.view()
        reach = self.tracker.reach(self.now, self.visible_to)
        waiting, self.waiting = self.waiting, []
        for pending, wake in waiting:
            found = poll(pending)
            reached = may_be_released(wake.needs, reach)
            if isinstance(found, WakeAt):
                self.waiting.append((pending, found if reached else WakeAt(found.instant, wake.needs)))
            else:
                assert reached, (pending.query, pending.interval, wake, reach, found)

    def pass_time(self) -> None:
        """Let time pass, and poll the gets whose instant has come."""
        self.now += self.rng.choice((0, 1, 2, 5))
        _, poll = self.view()
        waiting, self.waiting = self.waiting, []
        for pending, wake in waiting:
            found = poll(pending) if wake.instant is not None and wake.instant <= self.now else wake
            if isinstance(found, WakeAt):
                self.waiting.append((pending, found))


def may_be_released(needs: Needs | None, reach: Reach) -> bool:
    assert needs is not None, "a blocked get knows its condition"
    return any(
        need is not None and reached is not None and need <= reached for need, reached in zip(needs, reach, strict=True)
    )


@pytest.mark.parametrize("grouped", [False, True])
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**40), policy=st.sampled_from(POLICIES))
def test_every_released_wait_was_reached(grouped: bool, seed: int, policy: Policy) -> None:
    scenario = Scenario(seed, policy, grouped=grouped)
    for _ in range(40):
        scenario.block()
        scenario.step()
        scenario.pass_time()
