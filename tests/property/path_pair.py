"""A channel behind a whole path and the oracle side by side: every step is made on both, and everything agrees.

The methods are the language in which stories are told, whatever the path. After each of them nothing is under way
except what has to wait by the book; so each answer is known to the nanosecond although the path is a concurrent one.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import stampede_rt as st
from stampede_rt.model import Policy
from stampede_rt.status import from_error_message
from stampede_rt.timeline import MAX_INSTANT, MIN_INSTANT, Bound, Interval, Match, clamp
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.core.channel import Offer, Position, Query
from tests.oracle import (
    Item,
    OracleAnswer,
    OracleChannel,
    OracleGet,
    OracleNewest,
    OracleReader,
    OracleSubscription,
    Refused,
    Waits,
)
from tests.property.channel_pair import check_causes
from tests.property.loopback_host import LoopbackHost
from tests.property.path_agreement import same_answer, same_found, same_items, same_put
from tests.property.path_values import Follower, WaitingPut, merge, stated
from tests.property.surfaces import Started, Surface

LOOKS_MAX = 20_000
MOMENT_S = 0.002
REASONS = {"TOO_OLD": "too_old", "IN_FUTURE": "in_future", "ITEM_TOO_LARGE": "too_large", "CHANNEL_FULL": "full"}
_names = itertools.count()


class PathPair:
    """One channel, twice, and everybody who waits for it."""

    def __init__(self, surface: Surface, host: LoopbackHost, policy: Policy) -> None:
        self.surface, self.host, self.policy = surface, host, policy
        self.clock = host.settle_wall_clock()
        self.oracle = OracleChannel(policy)
        self.name = f"story/{next(_names)}"
        self.channel = self._handle(**stated(policy))
        self.payloads: dict[int, bytes] = {}
        self.gets: list[tuple[Query, bool, OracleGet, Started]] = []
        self.line: list[WaitingPut] = []
        self.followers: list[Follower] = []
        self._released: list[tuple[Started, OracleAnswer, Query, bool]] = []
        self._marks = itertools.count(1)
        self.settle()

    def _handle(self, **policy: Any) -> Any:
        return self.surface.do(lambda: self.surface.connection.channel(self.name, **policy))

    # --- puts

    def put_one(self, time: int | None, duration: int | None, length: int, timeout: float | None) -> None:
        """A put of the client's; with no timeout one that has to wait stays in line."""
        payload = self._payload(length)
        offer = Offer(times=None if time is None else [time], durations=_column([duration]), lengths=[length])
        fields = {"time": time, "duration": duration, "timeout": timeout}
        if timeout is None and self._will_wait(offer):
            handle = self._handle()  # of its own: the puts of one handle wait for each other
            started = self.surface.start(lambda: handle.put(payload, **fields))
            self.line.append(WaitingPut(offer.rest(0, self.clock), [payload], started))
            self._until(lambda stats: bool(stats.waiting_puts == len(self.line)))
            return
        verdicts, refusal = self._judge(offer, [payload])
        outcome = self._outcome(lambda: self.channel.put(payload, **fields))
        same_put(outcome, _only(verdicts) if verdicts else Refused(refusal or ""), payload)
        self.settle()

    def put_run(self, offer: Offer) -> None:
        """A run as a producer in any language sends it; what has to wait is refused at once."""
        payloads = [self._payload(length) for length in offer.lengths]
        verdicts, refusal = self._judge(offer, payloads)
        ack = self.surface.put_run(self._request(offer, payloads))
        assert not ack.HasField("error"), ack.error
        refused = {one.index: from_error_message(one.error).reason for one in ack.rejections}
        accepted = [verdict for verdict in verdicts if isinstance(verdict, Item)]
        expected = {at: one.reason for at, one in enumerate(verdicts) if isinstance(one, Refused)}
        expected |= {at: refusal for at in range(len(verdicts), len(payloads)) if refusal}
        assert refused == expected
        assert [ack.first_seq] * bool(accepted) == [item.seq for item in accepted[:1]]
        if accepted and offer.times is None:
            assert ack.stamped_unix_nano == accepted[0].time
        self.settle()

    def _request(self, offer: Offer, payloads: list[bytes]) -> pb.PutRequest:
        info = self.channel.info
        run = encode_run(payloads, times=offer.times, durations=offer.durations)
        request = pb.PutRequest(channel_id=info.channel_id, epoch=info.epoch)
        request.puts.add(wait_nanos=0).run.ParseFromString(run)
        return request

    def _payload(self, length: int) -> bytes:
        """Bytes that no other item of the story has, as far as the length allows."""
        return (next(self._marks).to_bytes(4, "big") * (length // 4 + 1))[:length]

    def _will_wait(self, offer: Offer) -> bool:
        if self.line:
            return True
        time = self.oracle.now(self.clock) if offer.times is None else offer.times[0]
        duration = None if offer.durations is None else offer.durations[0]
        trial = copy.deepcopy(self.oracle)
        return isinstance(trial.put(time, duration, offer.lengths[0], self.clock), Waits)

    def _judge(self, offer: Offer, payloads: list[bytes]) -> tuple[list[Item | Refused], str | None]:
        """The book's verdicts on a run that does not wait, and why the rest of it is refused."""
        verdicts: list[Item | Refused] = []
        if not self.line:
            verdicts = self._offer(offer, payloads)
        rest = len(payloads) - len(verdicts)
        self.oracle.rejected["CHANNEL_FULL"] += rest
        return verdicts, "CHANNEL_FULL" if rest else None

    def _offer(self, offer: Offer, payloads: list[bytes]) -> list[Item | Refused]:
        """Item after item, up to the first that has to wait."""
        verdicts: list[Item | Refused] = []
        stamp = self.oracle.now(self.clock)
        for index, length in enumerate(offer.lengths):
            time = stamp if offer.times is None else offer.times[index]
            duration = None if offer.durations is None or offer.durations[index] < 0 else offer.durations[index]
            verdict = self.oracle.put(time, duration, length, self.clock, offer.since if offer.times is None else None)
            if isinstance(verdict, Waits):
                break
            if isinstance(verdict, Item):
                self.payloads[verdict.seq] = payloads[index]
            verdicts.append(verdict)
        if any(isinstance(verdict, Item) for verdict in verdicts):
            self._announce()
        return verdicts

    def _advance_line(self) -> None:
        """Room may have been made: those in line are offered again, the first one first."""
        while self.line:
            head = self.line[0]
            verdicts = self._offer(head.offer, head.payloads)
            if not verdicts:
                return
            self.line.pop(0)
            same_put(head.started.outcome(), _only(verdicts), head.payloads[0])

    # --- time, promises and limits

    def tick(self, nanos: int, wall_step: int = 0) -> None:
        """Time passes; the host's clock follows a wall clock that was set by bending, never by stepping."""
        before, self.clock = self.clock, self.host.tick(nanos, wall_step=wall_step)
        passed = self.clock - before
        assert passed == nanos or (nanos // 2 <= passed <= nanos + nanos // 2 + 1)
        self._announce()
        self._advance_line()
        self.settle()

    def advance(self, instant: int) -> None:
        """A promise; one too far ahead is refused."""
        self.oracle.advance(instant)
        assert self.surface.do(lambda: self.channel.advance(instant)) == self.oracle.advanced_to
        self._announce()
        self._advance_line()
        self.settle()

    def configure(self, change: Policy) -> None:
        """Other limits while it runs; what is left out stays."""
        merged = merge(self.policy, change)
        answered = self.surface.do(lambda: self.channel.configure(**stated(change)))
        assert answered == merged
        self.policy = merged
        self.oracle.configure(merged, self.clock)
        self._announce()
        self._advance_line()
        self.settle()

    # --- reads

    def get(self, query: Query, *, payloads: bool = True, waits_s: float = 0) -> None:
        """A get that is answered within a moment: at once, or, with `waits_s`, when its time is over."""
        reader = self.reader()
        book = OracleGet(query)
        at_once = None if waits_s else reader.read(query, reader.resolve(query))
        expected = at_once or book.poll(reader) or book.give_up(reader)
        self._agree(self.surface.do(self._call(query, payloads, waits_s)), expected, query, payloads)

    def begin(self, query: Query, *, payloads: bool = True) -> None:
        """A get that waits until it is released."""
        book = OracleGet(query)
        expected = book.poll(self.reader())
        started = self.surface.start(self._call(query, payloads, None))
        if expected is not None:
            self._agree(started.outcome(), expected, query, payloads)
            return
        self.gets.append((query, payloads, book, started))
        self._until(lambda stats: bool(stats.waiting_gets == len(self.gets)))

    def may_block_on_time(self, query: Query) -> bool:
        """The get would be looked at again when an instant comes."""
        book, reader = OracleGet(query), self.reader()
        return book.poll(reader) is None and book.wake_at(reader) is not None

    def named_reads(self, instant: int, after: Position | None) -> None:
        """`at`, `before`, `oldest` and `newest`."""
        at = Query(interval=Interval(Bound(None, instant), Bound(None, instant)))
        self._agree(self.surface.do(lambda: self.channel.at(instant)), self._read(at), at, True)
        everything = Interval(Bound(None, MIN_INSTANT), Bound(None, MAX_INSTANT))
        before = replace(everything, end=Bound(None, instant), end_exclusive=True)
        position = self._position(after)
        for call, interval, newest_first, newer_than in (
            (lambda: self.channel.before(instant), before, True, None),
            (lambda: self.channel.oldest(), everything, False, None),
            (lambda: self.channel.newest(after=position), everything, True, after),
        ):
            query = Query(
                interval=interval, match=Match.START, limit=1, newest_first=newest_first, newer_than=newer_than
            )
            found = self.surface.do(call)
            same_found([] if found is None else [found], self._read(query), query, self.payloads)

    def refused_interval(self, start: int, end: int) -> None:
        """Two instants the wrong way round."""
        outcome = self._outcome(lambda: self.channel.get(max(start, end) + 1, min(start, end)))
        assert isinstance(outcome, st.InvalidInterval)
        assert str(max(start, end) + 1) in str(outcome)

    def _outcome(self, call: Callable[[], Any]) -> Any:
        """What a call gives, or the error that it raises."""
        try:
            return self.surface.do(call)
        except st.StampedeError as error:
            return error

    def reader(self) -> OracleReader:
        return OracleReader(self.oracle, self.clock)

    def _read(self, query: Query) -> OracleAnswer:
        reader = self.reader()
        return reader.read(query, reader.resolve(query))

    def _call(self, query: Query, payloads: bool, timeout: float | None) -> Callable[[], Any]:
        interval = query.interval
        bounds = ("(" if interval.start_exclusive else "[") + (")" if interval.end_exclusive else "]")
        return lambda: self.channel.get(
            interval.start,
            interval.end,
            bounds=bounds,
            match=query.match,
            limit=query.limit,
            newest_first=query.newest_first,
            after=self._position(query.after),
            complete=query.complete,
            payloads=payloads,
            timeout=timeout,
        )

    def _position(self, after: Position | None) -> st.Item | int | None:
        if after is None or after.seq is None:
            return None if after is None else after.time
        return st.Item(after.time, None, None, after.seq, b"", {}, "", 0, self.channel.incarnation)

    def _agree(self, found: st.Items, expected: OracleAnswer, query: Query, payloads: bool) -> None:
        same_answer(found, expected, query, self.payloads if payloads else None)
        assert found.incarnation == self.channel.incarnation

    # --- subscriptions

    def subscribe(self, start: Bound | None, after: Position | None, *, newest: bool) -> None:
        """In either mode, from either beginning."""
        reader, oracle = self.reader(), self.oracle
        last = max(((item.time, item.seq) for item in oracle.held), default=None)
        owed: list[int] = []
        if after is not None and after.seq is not None:
            owed, last = [seq for seq in oracle.log if seq > after.seq], (after.time, after.seq)
        elif start is not None and (instant := reader.instant_of(start)) is not None:
            owed, last = [item.seq for item in oracle.held if item.time >= instant], (instant, 0)
        mode = "newest" if newest else "all"
        position = None if after is None else self._position(after)
        followed = self.surface.follow(lambda: self.channel.subscribe(start, mode, position))
        book = OracleNewest(oracle, last, owed) if newest else OracleSubscription(oracle, owed)
        self.followers.append(Follower(followed, newest, book))
        self.settle()

    def _expect(self, follower: Follower) -> None:
        """What the subscription owes by now: held items in the order of seq, and the rest counted as dropped."""
        book = follower.book
        if isinstance(book, OracleNewest):
            item = book.take()
            if item is not None:
                follower.expected.append((item, self.oracle.end(item)))
            return
        owed = list(book.owed())
        follower.expected += [
            (self.oracle.log[seq], self.oracle.end(self.oracle.log[seq])) for seq in owed if book.is_held(seq)
        ]
        follower.dropped += sum(not book.is_held(seq) for seq in owed)
        book.settle(owed)

    # --- what holds after every step

    def _announce(self) -> None:
        """The channel has changed, or time has passed: blocked gets are looked at, first come first."""
        still = []
        reader = self.reader()
        for query, payloads, book, started in self.gets:
            expected = book.poll(reader)
            if expected is None:
                still.append((query, payloads, book, started))
            else:
                self._released.append((started, expected, query, payloads))
        self.gets = still

    def settle(self) -> None:
        """Everything that was set going has arrived, nothing else has, and the counters agree."""
        while self._released:
            started, expected, query, payloads = self._released.pop(0)
            self._agree(started.outcome(), expected, query, payloads)
        self.oracle.age(self.clock)
        for follower in self.followers:
            self._expect(follower)
        stats = self._until(self._has_all_been_delivered)
        for follower in self.followers:
            assert not follower.followed.ended, follower.followed.error
            same_items(follower.followed.items, follower.expected, self.payloads)
        for _, _, _, started in self.gets:
            assert not started.is_done(), started.outcome()
        assert (stats.waiting_gets, stats.waiting_puts) == (len(self.gets), len(self.line))
        self._check_counters(stats)

    def _has_all_been_delivered(self, stats: st.ChannelStats) -> bool:
        return stats.waiting_gets == len(self.gets) and all(
            len(one.followed.items) >= len(one.expected)
            and (one.newest or one.followed.subscription.dropped >= one.dropped)
            for one in self.followers
        )

    def _until(self, condition: Callable[[st.ChannelStats], bool]) -> st.ChannelStats:
        """Look, over the path, until it is so; the counters at that moment."""
        for _ in range(LOOKS_MAX):
            stats: st.ChannelStats = self.surface.do(self.channel.stats)
            if condition(stats):
                return stats
        raise AssertionError(f"it never came: {stats}, {self.followers}, {self.gets}, {self.line}")

    def _check_counters(self, stats: st.ChannelStats) -> None:
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
        assert (stats.host_time, stats.subscriptions) == (self.clock, len(self.followers))
        assert all(one.newest or one.followed.subscription.dropped == one.dropped for one in self.followers)

    def end(self) -> None:
        """The channel is deleted, and whoever waits for it is told."""
        for follower in self.followers:
            follower.followed.subscription.close()
        self.surface.do(self.channel.delete)
        outcomes = [one.started.outcome() for one in self.line] + [started.outcome() for *_, started in self.gets]
        assert all(isinstance(one, st.ChannelNotFound) for one in outcomes), outcomes


def _column(durations: list[int | None]) -> list[int] | None:
    return None if durations == [None] else [-1 if one is None else one for one in durations]


def _only(verdicts: Sequence[Item | Refused]) -> Item | Refused:
    (verdict,) = verdicts
    return verdict
