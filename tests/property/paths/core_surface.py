"""The pure core as a path, without transport or event loop (see `surfaces`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from unittest import mock

import stampede_rt as st
from stampede_rt.errors import ChannelNotFound, error_for
from stampede_rt.values.model import Policy
from stampede_rt.values.policy import parse_policy
from stampede_rt.values.statistics import ConsumerStats
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    MIN_INSTANT,
    Bound,
    BoundLike,
    clamp,
    parse_interval,
    parse_match,
)
from stampede_rt_channel_host.core.channel import LEASE_NANOS, Offer, Position, Query, item_blocks
from stampede_rt_channel_host.core.host_clock import HostTime
from tests.oracle import Ack
from tests.property.channel_pair import INCARNATION
from tests.property.paths.core_calls import Call
from tests.property.paths.core_owner import CoreOwner
from tests.property.paths.path_and_oracle import REASONS
from tests.property.paths.values import FollowedItems, Run, merge
from tests.support.clock import ManualClock


class CoreHost:
    """The host of all channels. Its clock moves only by `tick`."""

    def __init__(self) -> None:
        self._clock = ManualClock()
        self._time = HostTime(self._clock.boottime_nanos(), self._clock.time_unix_nano())
        self.owners: dict[str, CoreOwner] = {}

    def now(self) -> int:
        return self._time.read(self._clock.boottime_nanos(), self._clock.time_unix_nano())

    def tick(self, nanos: int, *, wall_step: int = 0) -> int:
        self._clock.set_wall_clock(self._clock.time_unix_nano() + wall_step)
        self._clock.advance(nanos)
        for owner in self.owners.values():
            owner.time_has_passed()
        return self.now()

    def settle_wall_clock(self) -> int:
        self._clock.set_wall_clock(self.now())
        return self.now()


class CoreConnection:
    """A client."""

    def __init__(self, host: CoreHost, consumer_id: int) -> None:
        self._host = host
        self._consumer_id = consumer_id

    def channel(self, name: str, **policy: Any) -> CoreHandle:
        if name not in self._host.owners:
            self._host.owners[name] = CoreOwner(name, parse_policy(**policy), self._host.now)
        return CoreHandle(self._host, name, self._consumer_id)


class CoreHandle:
    """Has the same methods as a client's handle of a channel. A put, and a get with a timeout, return a `Call`."""

    incarnation = INCARNATION

    def __init__(self, host: CoreHost, name: str, consumer_id: int) -> None:
        self._host = host
        self._name = name
        self._consumer_id = consumer_id
        self.owner = host.owners[name]

    def put(self, payload: bytes, *, time: int | None, duration: int | None, timeout: float | None) -> Call:
        times, durations = (None if one is None else [one] for one in (time, duration))
        run = Run(Offer(times=times, durations=durations, lengths=[len(payload)]), [payload], waits=timeout is None)
        return self.owner.put(run).then(lambda ack: _accepted(ack, run))

    def get(
        self,
        start: BoundLike,
        end: BoundLike,
        *,
        bounds: str = "[]",
        limit: int | None = None,
        newest_first: bool = False,
        match: Any = "span",
        after: Any = None,
        newer_than: Any = None,
        complete: bool = False,
        payloads: bool = True,
        timeout: float | None = 0,
    ) -> Any:
        query = Query(
            interval=parse_interval(start, end, bounds),
            match=parse_match(match),
            limit=limit,
            newest_first=newest_first,
            complete=complete,
            after=_position(after),
            newer_than=_position(newer_than),
        )
        return self.owner.read(query, payloads) if timeout == 0 else self.owner.get(query, payloads)

    def at(self, time: BoundLike) -> st.Items:
        found: st.Items = self.get(time, time)
        return found

    def before(self, time: BoundLike) -> st.Item | None:
        return _only(self.get(MIN_INSTANT, time, bounds="[)", match="start", limit=1, newest_first=True))

    def oldest(self) -> st.Item | None:
        return _only(self.get(MIN_INSTANT, MAX_INSTANT, match="start", limit=1))

    def newest(self, after: st.Item | int | None = None) -> st.Item | None:
        arguments = {"match": "start", "limit": 1, "newest_first": True, "newer_than": after}
        return _only(self.get(MIN_INSTANT, MAX_INSTANT, **arguments))

    def subscribe(self, start: Bound | None, mode: str, after: st.Item | None) -> FollowedItems:
        core, now, position = self.owner.channel, self._host.now(), _position(after)
        begin: Callable[..., Any] = core.subscribe_newest if mode == "newest" else core.subscribe_all
        return self.owner.follow(begin(now, start=start, after=position)).followed

    def advance(self, instant: int) -> int:
        return self.owner.advance(instant)

    def consume(self, items: Iterable[st.Item]) -> int:
        return self.owner.consume(self._consumer_id, [item.seq for item in items], LEASE_NANOS)[0]

    def configure(self, **policy: Any) -> Policy:
        self.owner.configure(merge(self.owner.policy, parse_policy(**policy)))
        return self.owner.policy

    def delete(self) -> None:
        del self._host.owners[self._name]
        self.owner.end(ChannelNotFound(f"channel {self._name!r} is deleted"))

    def stats(self) -> st.ChannelStats:
        owner, core, now = self.owner, self.owner.channel, self._host.now()
        counters = core.counters(now)
        return st.ChannelStats(
            accepted=counters.accepted,
            held=counters.held,
            collected=counters.collected,
            rejected={name: counters.rejected[reason] for reason, name in REASONS.items()},
            accepted_bytes=counters.accepted_bytes,
            held_bytes=counters.held_bytes,
            delivered_bytes=0,
            newest=core.newest,
            oldest=core.oldest,
            frontier=None if core.frontier is None else clamp(core.frontier),
            advance=core.advanced_to,
            subscriptions=len(owner.followers),
            waiting_gets=len(owner.gets),
            waiting_puts=len(owner.line),
            incarnation=core.incarnation,
            host_time=now,
            consumers=[
                ConsumerStats(consumer_id=one.consumer_id, lease_nanos=one.lease_nanos, waiting=one.waiting)
                for one in core.consumers(now)
            ],
        )


class CoreSurface:
    """A surface over the core. `do` fails if its call has to wait."""

    def __init__(self, host: CoreHost) -> None:
        self._owners: dict[int, CoreOwner] = {}
        self.connections = [CoreConnection(host, consumer_id) for consumer_id in (101, 102, 103)]

    def do(self, call: Callable[[], Any]) -> Any:
        outcome = call()
        if isinstance(outcome, Call):
            outcome = outcome.run_to_end()
        if isinstance(outcome, st.StampedeError):
            raise outcome
        return outcome

    def start(self, call: Callable[[], Call]) -> Call:
        return call()

    def put_run(self, handle: CoreHandle, run: Run) -> Call:
        self._owners[id(run)] = handle.owner
        return handle.owner.put(run)

    def break_stream(self, run: Run) -> None:
        self._owners[id(run)].withdraw(run)

    def consume(self, handle: CoreHandle, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> tuple[int, int]:
        return handle.owner.consume(consumer_id, seqs, lease_nanos)

    def follow(self, subscribe: Callable[[], FollowedItems]) -> FollowedItems:
        return subscribe()


@contextmanager
def core_surface(items_per_block: int) -> Iterator[tuple[CoreSurface, CoreHost]]:
    """Yield the core as a surface, and its host.

    `items_per_block`: the usual size of the blocks of `item_blocks`. It is small, because the tests have few items.
    """
    host = CoreHost()
    with mock.patch.object(item_blocks, "BLOCK_ITEMS", items_per_block):
        yield CoreSurface(host), host


def _accepted(ack: Ack, run: Run) -> st.Item | st.StampedeError:
    for reason in ack.refused.values():
        return error_for(reason, "the item was refused")
    seq, stamped = ack.first
    times, durations = run.offer.times, run.offer.durations
    time, duration = stamped if times is None else times[0], None if durations is None else durations[0]
    assert time is not None
    return st.Item(time, None, duration, seq, run.payloads[0], {}, "", run.offer.lengths[0], INCARNATION)


def _position(after: st.Item | int | None) -> Position | None:
    if after is None:
        return None
    return Position(after.time, after.seq, after.incarnation) if isinstance(after, st.Item) else Position(after)


def _only(found: st.Items) -> st.Item | None:
    return found[0] if found else None
