"""A channel that is read over a whole path (a `Surface`), and the oracle's channel. Compares their counters."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, Protocol

import stampede_rt as st
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.channel import Position
from tests.oracle import OracleChannel, OracleReader
from tests.property.channel_pair import check_causes
from tests.property.paths.surfaces import Surface
from tests.property.paths.values import Follower, OracleRun, policy_arguments

LOOKS_MAX = 20_000
REASONS = {"TOO_OLD": "too_old", "IN_FUTURE": "in_future", "ITEM_TOO_LARGE": "too_large", "CHANNEL_FULL": "full"}
OWN_CONSUMER = 0
"""The oracle's number for the consumer that the client of the first connection registers.

Only the client knows its real id.
"""
_names = itertools.count()


class SteeredHost(Protocol):
    """The host of the channels. Its clock moves only by `tick`."""

    def tick(self, nanos: int, *, wall_step: int = 0) -> int:
        """Let `nanos` pass, and move the wall clock by `wall_step`. Returns the host's time afterwards."""

    def settle_wall_clock(self) -> int:
        """Set the wall clock to the host's time, so that the host has no difference to make up. Returns this time."""


class PathAndOracle:
    """One channel behind a path and in the oracle. Each client has a handle, and the handles make the calls in turn."""

    def __init__(self, surface: Surface, host: SteeredHost, policy: Policy) -> None:
        self.surface, self.host, self.policy = surface, host, policy
        self.clock = host.settle_wall_clock()
        self.oracle = OracleChannel(policy)
        self.name = f"scenario/{next(_names)}"
        others = range(1, len(surface.connections))
        self.handles = [self.open(0, **policy_arguments(policy)), *map(self.open, others)]
        # An odd number of turns, so the last handle may have two: each use of `channel` takes a turn. With an even
        # number, a step that takes two turns would always read with the same half of the clients.
        self._turns = itertools.cycle(self.handles if len(self.handles) % 2 else [*self.handles, self.handles[-1]])
        self.payloads: dict[int, bytes] = {}
        self.line: list[OracleRun] = []
        self.followers: list[Follower] = []

    def open(self, who: int, **policy: Any) -> Any:
        """Open a further handle for one of the clients."""
        return self.surface.do(lambda: self.surface.connections[who].channel(self.name, **policy))

    @property
    def channel(self) -> Any:
        """The handle whose turn it is. Each use ends a turn."""
        return next(self._turns)

    def reader(self) -> OracleReader:
        return OracleReader(self.oracle, self.clock)

    def outcome(self, call: Callable[[], Any]) -> Any:
        """The result of a call, or the error that it raises."""
        try:
            return self.surface.do(call)
        except st.StampedeError as error:
            return error

    def position(self, after: Position | None) -> st.Item | int | None:
        """A position as callers state it: an instant, or an item that they have read."""
        if after is None or after.seq is None:
            return None if after is None else after.time
        return self.item(after.time, after.seq)

    def item(self, time: int, seq: int) -> st.Item:
        """An item with only the fields that identify it."""
        return st.Item(time, None, None, seq, b"", {}, "", 0, self.channel.incarnation)

    def until(self, condition: Callable[[st.ChannelStats], bool]) -> st.ChannelStats:
        """Read the counters over the path until they meet the condition. Returns them."""
        for _ in range(LOOKS_MAX):
            stats: st.ChannelStats = self.surface.do(self.channel.stats)
            if condition(stats):
                return stats
        raise AssertionError(f"the condition never came true: {stats}, {self.line}, {self.followers}")

    def check_counters(self, stats: st.ChannelStats) -> None:
        """Check that the counters, the newest and oldest times, frontier and advance agree with the oracle's."""
        oracle = self.oracle
        assert stats.accepted == stats.held + sum(stats.collected.values()) == len(oracle.log)
        check_causes(stats.collected, oracle.collected)
        counted = {name: oracle.rejected[reason] for reason, name in REASONS.items()}
        assert {name: stats.rejected[name] for name in counted} == counted
        assert stats.held_bytes == sum(item.length for item in oracle.held)
        assert stats.accepted_bytes == sum(item.length for item in oracle.log.values())
        assert (stats.newest, stats.oldest) == (oracle.newest, oracle.oldest)
        frontier = None if oracle.frontier is None else clamp(oracle.frontier)
        assert (stats.frontier, stats.advance) == (frontier, oracle.advanced_to)
        assert stats.host_time == self.clock
        assert all(one.newest or one.followed.subscription.dropped == one.dropped for one in self.followers)
        self._check_places(stats)

    def _check_places(self, stats: st.ChannelStats) -> None:
        """Check each consumer's lease and its number of owed items.

        The client renews its own lease at times that no test knows.
        """
        taken = self.oracle.consumers.taken if self.oracle.consumers else []
        held = [item.seq for item in self.oracle.held]
        expected = {
            place.consumer_id: (place.until - self.clock if not place.ended else 0, sum(map(place.owes, held)))
            for place in taken
        }
        own = expected.pop(OWN_CONSUMER, None)
        shown = {one.consumer_id: (one.lease_nanos, one.waiting) for one in stats.consumers}
        others = {consumer_id: place for consumer_id, place in shown.items() if consumer_id in expected}
        assert others == expected
        left = [place for consumer_id, place in shown.items() if consumer_id not in expected]
        assert [waiting for lease, waiting in left if lease] == ([] if own is None else [own[1]])
        assert len(left) == (own is not None)
