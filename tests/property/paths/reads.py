"""Reads and subscriptions over a path.

Each answer must be the oracle's, and come at the moment that the oracle names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import stampede_rt as st
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Bound, Interval, Match
from stampede_rt_channel_host.core.channel import Position, Query
from tests.oracle import OracleAnswer, OracleGet, OracleNewest, OracleSubscription
from tests.property.paths.agreement import same_answer, same_found, same_items
from tests.property.paths.path_and_oracle import PathAndOracle, SteeredHost
from tests.property.paths.steered_rings import follows_ring
from tests.property.paths.surfaces import Surface
from tests.property.paths.values import Follower, StartedCall

EVERYTHING = Interval(Bound(None, MIN_INSTANT), Bound(None, MAX_INSTANT))


class PathReads(PathAndOracle):
    """`PathAndOracle`, with readers."""

    def __init__(self, surface: Surface, host: SteeredHost, policy: Policy) -> None:
        super().__init__(surface, host, policy)
        self.gets: list[tuple[Query, bool, OracleGet, StartedCall]] = []
        self._released: list[tuple[StartedCall, OracleAnswer, Query, bool]] = []
        self.settle()

    def get(self, query: Query, *, payloads: bool = True, waits_s: float = 0) -> st.Items:
        """A get that is answered immediately, or, with `waits_s`, at the end of its time."""
        reader = self.reader()
        predictor = OracleGet(query)
        immediate = None if waits_s else reader.read(query, reader.resolve(query))
        expected = immediate or predictor.poll(reader) or predictor.give_up(reader)
        found: st.Items = self.surface.do(self._call(query, payloads, waits_s))
        self._agree(found, expected, query, payloads)
        return found

    def begin(self, query: Query, *, payloads: bool = True) -> None:
        """Begin a get that waits until something releases it."""
        predictor = OracleGet(query)
        expected = predictor.poll(self.reader())
        started = self.surface.start(self._call(query, payloads, None))
        if expected is not None:
            self._agree(started.outcome(), expected, query, payloads)
            return
        self.gets.append((query, payloads, predictor, started))
        self.until(lambda stats: bool(stats.waiting_gets == len(self.gets)))

    def may_block_on_time(self, query: Query) -> bool:
        """Whether the host would look at the get again at some instant."""
        predictor, reader = OracleGet(query), self.reader()
        return predictor.poll(reader) is None and predictor.wake_at(reader) is not None

    def pages(self, query: Query) -> None:
        """Read a whole answer page by page. Each page continues after the last item of the page before."""
        whole = self.get(replace(query, limit=None))
        paged: list[st.Item] = []
        while True:
            page = self.get(query)
            paged += page
            if not page.more:
                break
            query = replace(query, after=Position(page[-1].time, page[-1].seq))
        assert paged == list(whole)

    def named_reads(self, bound: Bound, after: Position | None) -> None:
        """Check `at`, `before`, `oldest` and `newest`."""
        point = bound.offset if bound.meta is None else bound
        at = Query(interval=Interval(bound, bound))
        self._agree(self.surface.do(lambda: self.channel.at(point)), self._read(at), at, True)
        before = Interval(EVERYTHING.start, bound, end_exclusive=True)
        position = self.position(after)
        for call, interval, newest_first, newer_than in (
            (lambda: self.channel.before(point), before, True, None),
            (lambda: self.channel.oldest(), EVERYTHING, False, None),
            (lambda: self.channel.newest(after=position), EVERYTHING, True, after),
        ):
            query = Query(
                interval=interval, match=Match.START, limit=1, newest_first=newest_first, newer_than=newer_than
            )
            found = self.surface.do(call)
            same_found([] if found is None else [found], self._read(query), query, self.payloads)

    def refused_interval(self, start: int, end: int) -> None:
        """Check that an interval whose end is before its start is refused."""
        outcome = self.outcome(lambda: self.channel.get(max(start, end) + 1, min(start, end)))
        assert isinstance(outcome, st.InvalidInterval)
        assert str(max(start, end) + 1) in str(outcome)

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
            after=self.position(query.after),
            complete=query.complete,
            payloads=payloads,
            timeout=timeout,
        )

    def _agree(self, found: st.Items, expected: OracleAnswer, query: Query, payloads: bool) -> None:
        same_answer(found, expected, query, self.payloads if payloads else None)
        assert found.incarnation == self.channel.incarnation

    # --- subscriptions

    def subscribe(self, start: Bound | None, after: Position | None, *, newest: bool) -> None:
        """Begin a subscription in either mode, from either kind of start."""
        reader, oracle = self.reader(), self.oracle
        last = max(((item.time, item.seq) for item in oracle.held), default=None)
        owed: list[int] = []
        if after is not None and after.seq is not None:
            owed, last = [seq for seq in oracle.log if seq > after.seq], (after.time, after.seq)
        elif start is not None and (instant := reader.instant_of(start)) is not None:
            owed, last = [item.seq for item in oracle.held if item.time >= instant], (instant, 0)
        mode = "newest" if newest else "all"
        position = None if after is None else self.position(after)
        followed = self.surface.follow(lambda: self.channel.subscribe(start, mode, position))
        predictor = OracleNewest(oracle, last, owed) if newest else OracleSubscription(oracle, owed)
        self.followers.append(Follower(followed, newest, predictor))
        self.settle()

    def _expect(self, follower: Follower) -> None:
        """Compute the items that the subscription must have by now: held items in the order of seqs; the others count
        as dropped.
        """
        predictor = follower.predictor
        if isinstance(predictor, OracleNewest):
            item = predictor.take()
            if item is not None:
                follower.expected.append((item, self.oracle.end(item)))
            return
        owed = list(predictor.owed())
        follower.expected += [
            (self.oracle.log[seq], self.oracle.end(self.oracle.log[seq])) for seq in owed if predictor.is_held(seq)
        ]
        follower.dropped += sum(not predictor.is_held(seq) for seq in owed)
        predictor.settle(owed)

    # --- checks after every step

    def announce(self) -> None:
        """Let the oracle look at its blocked gets in the order in which they came, because the channel has changed or
        time has passed.
        """
        still = []
        reader = self.reader()
        for query, payloads, predictor, started in self.gets:
            expected = predictor.poll(reader)
            if expected is None:
                still.append((query, payloads, predictor, started))
            else:
                self._released.append((started, expected, query, payloads))
        self.gets = still

    def settle(self) -> None:
        """Wait until the answers and items of all begun reads have arrived.

        Check that nothing else has arrived, and that the counters agree.
        """
        while self._released:
            started, expected, query, payloads = self._released.pop(0)
            self._agree(started.outcome(), expected, query, payloads)
        self.oracle.age(self.clock)
        for follower in self.followers:
            self._expect(follower)
        stats = self.until(self._has_all_been_delivered)
        for follower in self.followers:
            assert not follower.followed.ended, follower.followed.error
            same_items(follower.followed.items, follower.expected, self.payloads)
        for _, _, _, started in self.gets:
            assert not started.is_done(), started.outcome()
        assert (stats.waiting_gets, stats.waiting_puts) == (len(self.gets), len(self.line))
        self.check_counters(stats)

    def _has_all_been_delivered(self, stats: st.ChannelStats) -> bool:
        at_host = sum(not follows_ring(one.followed.subscription) for one in self.followers)
        return (stats.waiting_gets, stats.subscriptions) == (len(self.gets), at_host) and all(
            len(one.followed.items) >= len(one.expected)
            and (one.newest or one.followed.subscription.dropped >= one.dropped)
            for one in self.followers
        )
