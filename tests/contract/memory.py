"""The methods of a channel, directly on the pure core: without network and processes, with the same bytes."""

from __future__ import annotations

import asyncio
import copy
import random
from collections import deque
from dataclasses import fields, replace
from typing import Any

import stampede_rt as st
from stampede_rt.v1 import item_pb2
from stampede_rt.values.model import Policy
from stampede_rt.values.payloads import check_attributes, check_payload
from stampede_rt.values.policy import parse_policy
from stampede_rt.values.statistics import ConsumerStats
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    MIN_INSTANT,
    Match,
    parse_bound,
    parse_instant,
    parse_interval,
    parse_item_duration,
    parse_match,
)
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.run_slices import slice_run
from stampede_rt.wire.runs import encode_run, seal_run, select_items
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    Offer,
    Position,
    PutOutcome,
    Query,
    ReadAnswer,
    Slice,
    WakeAt,
)
from stampede_rt_channel_host.core.channel.values import NO_NEXT_TIMES

LIMIT_BYTES = 1 << 20


class MemoryConnection:
    """Opens channels in the memory of this object. A connection that joins another one shares its channels."""

    def __init__(self, joins: MemoryConnection | None = None) -> None:
        self._channels: dict[str, MemoryChannel] = joins._channels if joins else {}
        self._consumer_id = random.getrandbits(63) | 1

    async def channel(self, name: str, **policy: Any) -> MemoryChannel:
        if name not in self._channels:
            self._channels[name] = MemoryChannel(name, **policy)
        return self._channels[name].seen_by(self._consumer_id)

    async def aclose(self) -> None:
        for channel in self._channels.values():
            channel.seen_by(self._consumer_id).leave()


class MemoryChannel:
    def __init__(self, name: str, **policy: Any) -> None:
        stated = parse_policy(**policy)
        self._overlap_nanos = stated.overlap_nanos or 0
        self.name = name
        self._consumer_id = 0
        self.core = ChannelCore(stated, incarnation=random.getrandbits(63) | 1, name=name)
        self._content_type = stated.content_type or ""
        self._changed: set[asyncio.Event] = set()
        self._waiting = {"gets": 0, "puts": 0}
        self._line: deque[asyncio.Event] = deque()  # the line of waiting puts

    def seen_by(self, consumer_id: int) -> MemoryChannel:
        """Return the same channel for another consumer."""
        handle = copy.copy(self)
        handle._consumer_id = consumer_id
        return handle

    async def consume(self, items: Any) -> int:
        named = [items] if isinstance(items, st.Item) else list(items)
        if not all(isinstance(item, st.Item) for item in named):
            raise st.InvalidArgument("items are consumed, nothing else")
        if any(item.incarnation != self.core.incarnation for item in named):
            raise st.IncarnationLost("another incarnation, or another channel's items")
        consumed = self.core.consume(self._consumer_id, [item.seq for item in named], st.now())
        self._wake()
        return consumed.items

    def leave(self) -> None:
        if any(place.consumer_id == self._consumer_id for place in self.core.consumers(st.now())):
            self.core.consume(self._consumer_id, [], st.now(), lease_nanos=0)
            self._wake()

    async def configure(self, **changes: Any) -> Policy:
        stated = parse_policy(**changes)
        stated_fields = {field.name: getattr(stated, field.name) for field in fields(stated)}
        policy = replace(
            self.core.policy, **{name: value for name, value in stated_fields.items() if value is not None}
        )
        self.core.configure(policy, st.now())
        self._wake()
        return policy

    def _wake(self) -> None:
        for event in self._changed:
            event.set()

    async def put(
        self, payload: Any, *, time: Any = None, duration: Any = None, attributes: Any = None, **rest: Any
    ) -> st.Item:
        payload = check_payload(payload)
        check_attributes(attributes)
        nanos = parse_item_duration(duration)
        times = None if time is None else [parse_instant(time)]
        durations = None if nanos is None else [nanos]
        raw = encode_run([payload], times=times, durations=durations, attributes=attributes)

        def seal(first_seq: int, kept: Any, stamped_time: int | None) -> bytes:
            chosen = raw if kept is None else select_items(raw, kept)
            return seal_run(chosen, first_seq, None if stamped_time is None else [stamped_time])

        offer = Offer(times=times, durations=durations, lengths=[len(payload)])
        outcome = await self._put(offer, seal, rest.get("timeout"))
        if outcome.rejections:
            raise outcome.rejections[0].error
        assert outcome.run is not None
        self._wake()
        return self._items([Slice(outcome.run, 0, 1)], None, payloads=True)[0]

    async def _put(self, offer: Offer, seal: Any, timeout: float | None) -> PutOutcome:
        """Put after all puts that wait already."""
        deadline = None if timeout is None else st.now() + round(timeout * 1e9)
        event = asyncio.Event()
        self._line.append(event)
        self._changed.add(event)
        try:
            while True:
                first = self._line[0] is event
                outcome = self.core.put(offer, st.now(), seal) if first else PutOutcome(waiting=0)
                if outcome.waiting is None:
                    return outcome
                offer = offer.rest(outcome.waiting, st.now())
                if deadline is not None and st.now() >= deadline:
                    return self.core.give_up_put(offer)
                instants = [instant for instant in (deadline, outcome.retry_at) if instant is not None]
                self._waiting["puts"] += 1
                await self._until(event, min(instants, default=None))
                self._waiting["puts"] -= 1
        finally:
            self._changed.discard(event)
            self._line.remove(event)
            self._wake()

    def producer(self) -> MemoryProducer:
        return MemoryProducer(self)

    async def get(self, start: Any, end: Any, *, bounds: str = "[]", match: str = "span", **rest: Any) -> st.Items:
        after = rest.get("after")
        query = Query(
            interval=parse_interval(start, end, bounds),
            match=parse_match(match),
            limit=rest.get("limit"),
            newest_first=rest.get("newest_first", False),
            after=None if after is None else _position(after),
            complete=rest.get("complete", False),
        )
        return await self._read(query, rest.get("timeout", 0), rest.get("payloads", True))

    async def at(self, time: Any, timeout: float = 0) -> st.Items:
        return await self._read(Query(interval=parse_interval(time, time)), timeout, True)

    async def before(self, time: Any, timeout: float = 0) -> st.Item | None:
        return await self._one(parse_interval(MIN_INSTANT, time, "[)"), True, None, timeout)

    async def oldest(self, timeout: float = 0) -> st.Item | None:
        return await self._one(parse_interval(MIN_INSTANT, MAX_INSTANT), False, None, timeout)

    async def newest(self, after: Any = None, timeout: float = 0) -> st.Item | None:
        return await self._one(parse_interval(MIN_INSTANT, MAX_INSTANT), True, after, timeout)

    async def _one(self, interval: Any, newest_first: bool, newer_than: Any, timeout: float) -> st.Item | None:
        position = None if newer_than is None else _position(newer_than)
        query = Query(interval=interval, match=Match.START, limit=1, newest_first=newest_first, newer_than=position)
        items = await self._read(query, timeout, True)
        return items[0] if items else None

    async def _read(self, query: Query, timeout: float, payloads: bool) -> st.Items:
        if not timeout:
            return self._answer(self.core.read(query, st.now()), query, payloads)
        pending = self.core.begin(query, st.now())
        event = asyncio.Event()
        self._changed.add(event)
        self._waiting["gets"] += 1
        try:
            async with asyncio.timeout(timeout):
                while isinstance(polled := self.core.poll(pending, st.now()), WakeAt):
                    await self._until(event, polled.instant)
            answer = polled
        except TimeoutError:
            answer = self.core.give_up(pending, st.now())
        finally:
            self._changed.discard(event)
            self._waiting["gets"] -= 1
        return self._answer(answer, query, payloads)

    async def _until(self, event: asyncio.Event, instant: int | None) -> None:
        event.clear()
        try:
            async with asyncio.timeout(None if instant is None else max(0, instant - st.now()) / 1e9):
                await event.wait()
        except TimeoutError:
            return

    def _answer(self, answer: ReadAnswer, query: Query, payloads: bool) -> st.Items:
        items = self._items(answer.slices, answer.next_time, answer.next_times, payloads=payloads)
        if query.newest_first:
            items.reverse()
        return st.Items(
            items,
            interval=answer.interval,
            complete=answer.complete,
            truncated=answer.truncated,
            more=answer.more,
            reason=answer.reason,
            incarnation=answer.incarnation,
        )

    def _items(
        self, slices: Any, next_time: int | None, next_times: Any = NO_NEXT_TIMES, *, payloads: bool
    ) -> list[st.Item]:
        delivered = [
            item_pb2.DeliveredRun(
                run=self._run(one, payloads), next_time_unix_nano=next_times.get((one.last_time, one.end_seq))
            )
            for one in slices
        ]
        if delivered and next_time is not None:
            delivered[-1].next_time_unix_nano = next_time
        decoder = ItemDecoder(
            incarnation=self.core.incarnation,
            content_type=self._content_type,
            payloads=payloads,
            overlap_nanos=self._overlap_nanos,
        )
        return [*decoder.decode(delivered)]

    def _run(self, one: Slice, payloads: bool) -> item_pb2.ItemRun:
        return item_pb2.ItemRun.FromString(slice_run(one.run.body, one.lo, one.hi, without_payloads=not payloads))

    def subscribe(self, start: Any = None, mode: str = "all", after: Any = None, *, payloads: bool = True) -> Any:
        if mode not in ("all", "newest"):
            raise st.InvalidArgument(f"mode is {mode!r}")
        return MemorySubscription(self, start, mode, after, payloads)

    async def advance(self, time: int) -> int:
        advanced = self.core.advance(time, st.now())
        self._wake()
        return advanced

    async def stats(self) -> st.ChannelStats:
        await asyncio.sleep(0)  # let the tasks run that were just woken
        counters = self.core.counters(st.now())
        names = {"TOO_OLD": "too_old", "IN_FUTURE": "in_future", "ITEM_TOO_LARGE": "too_large", "CHANNEL_FULL": "full"}
        return st.ChannelStats(
            accepted=counters.accepted,
            held=counters.held,
            collected=counters.collected,
            rejected={names.get(key, key): count for key, count in counters.rejected.items()},
            accepted_bytes=counters.accepted_bytes,
            held_bytes=counters.held_bytes,
            delivered_bytes=0,
            newest=self.core.newest,
            oldest=self.core.oldest,
            frontier=self.core.frontier,
            advance=self.core.advanced_to,
            subscriptions=0,
            waiting_gets=self._waiting["gets"],
            waiting_puts=self._waiting["puts"],
            incarnation=self.core.incarnation,
            host_time=st.now(),
            policy=self.core.policy,
            consumers=[
                ConsumerStats(consumer_id=one.consumer_id, lease_nanos=one.lease_nanos, waiting=one.waiting)
                for one in self.core.consumers(st.now())
            ],
            clock_offset_nanos=0,
        )


class MemoryProducer:
    def __init__(self, channel: MemoryChannel) -> None:
        self._channel = channel
        self._rejected: list[st.StampedeError] = []
        self.accepted = self.rejections = 0

    async def __aenter__(self) -> MemoryProducer:
        return self

    async def __aexit__(self, *error: object) -> None:
        return None

    async def put(self, payload: bytes, **rest: Any) -> None:
        try:
            await self._channel.put(payload, **rest)
            self.accepted += 1
        except st.StampedeError as error:
            self._rejected.append(error)
            self.rejections += 1

    async def flush(self) -> None:
        rejected, self._rejected = self._rejected, []
        if rejected:
            raise rejected[0]


class MemorySubscription:
    def __init__(self, channel: MemoryChannel, start: Any, mode: str, after: Any, payloads: bool) -> None:
        self._channel, self._payloads, self._newest = channel, payloads, mode == "newest"
        begin = channel.core.subscribe_newest if self._newest else channel.core.subscribe_all
        bound = None if start is None else parse_bound(start)
        self._cursor: Any = begin(st.now(), start=bound, after=None if after is None else _position(after))
        self._event = asyncio.Event()
        channel._changed.add(self._event)
        self._ready: deque[st.Item] = deque()
        self._closed = False
        self.dropped = self.skipped = 0

    async def __aenter__(self) -> MemorySubscription:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._closed = True
        self._event.set()

    def __aiter__(self) -> MemorySubscription:
        return self

    async def __anext__(self) -> st.Item:
        while not self._ready:
            if self._closed:
                raise StopAsyncIteration
            self._event.clear()
            if not self._take():
                await self._event.wait()
        return self._ready.popleft()

    def _take(self) -> bool:
        core, now = self._channel.core, st.now()
        if self._newest:
            one = core.latest(self._cursor, now)
            taken = [] if one is None else [one]
            self.skipped = self._cursor.skipped
        else:
            delivery = core.since(self._cursor, now, LIMIT_BYTES)
            self.dropped += delivery.gap.items if delivery.gap else 0
            taken = list(delivery.slices)
        for one in taken:
            self._ready.extend(self._channel._items([one.slice], one.next_time, payloads=self._payloads))
        return bool(taken)


def _position(after: Any) -> Position:
    if isinstance(after, st.Item):
        return Position(after.time, after.seq, after.incarnation)
    return Position(parse_instant(after))
