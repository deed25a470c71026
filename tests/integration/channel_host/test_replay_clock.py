"""Replays of recorded channels under a virtual clock, at a real host."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt._sync import earlier_pages
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import recorded_cluster_fixture
from tests.support.waiting import wait_until

MS, SECOND = 10**6, 10**9
FRAMES = 24

cluster = recorded_cluster_fixture()


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


def depth(rt: Any, found: list[object]) -> list[object]:
    """A short form of the stereo demo's consumer: pairs of both cameras, and frames without a partner."""
    with rt.group("stereo").match("eye/left", "4ms", partial=True) as matches:
        found.append("open")
        for matched in islice(matches, FRAMES):
            right = None if matched.missing else matched["eye/right"]
            found.append((matched["eye/left"].payload, right and right.payload, right and right.seq, matched.time))
        found.append((matches.unmatched, matches.dropped))
    return found


def surveyed(rt: Any, found: list[object]) -> list[object]:
    """A consumer that reads through the group: at each match it reads all frames of the last 25 ms before the match."""
    group = rt.group("stereo")
    with group.match("eye/left", "4ms", partial=True) as matches:
        found.append("open")
        for matched in islice(matches, FRAMES):
            shown = group.get(matched.time - 25 * MS, matched.time, bounds="[)", match="start")
            found.append([[(one.payload, one.seq, one.time) for one in items] for items in shown.values()])
    return found


def film(left: st.Channel, right: st.Channel, began: int, *seen: list[object]) -> None:
    """Put the frames of both cameras. Some frames of the right camera come late, out of order, or never.

    `seen`: the lists of the live consumers. Before the next frame, wait until every list has all decided frames. So
    each consumer finds a frame soon after its decision.
    """
    decided = 0
    for number in range(FRAMES):
        at = began + number * 10 * MS
        left.put(b"left %d" % number, time=at)
        if number % 5 == 4:
            right.put(b"right %d late" % (number - 1), time=at - 9 * MS)
        if number % 7 != 6:
            right.put(b"right %d" % number, time=at + (number % 3) * MS)
            decided = number  # the frames before this one are decided
        wait_until(lambda decided=decided: all(len(one) > decided for one in seen))
    for channel in (left, right):
        channel.advance(began + SECOND)


def test_ten_replays_at_three_speeds_give_a_consumer_the_same_items_as_the_live_run(rt: st.Connection) -> None:
    left, right = (rt.channel(f"eye/{side}", max_age="60s", archive="7d") for side in ("left", "right"))
    rt.group("stereo", [left, right])
    start, live, surveyed_live = left.stats().host_time, [], []
    consumers = [
        threading.Thread(target=depth, args=(rt, live)),
        threading.Thread(target=surveyed, args=(rt, surveyed_live)),
    ]
    for consumer in consumers:
        consumer.start()
    wait_until(lambda: live and surveyed_live)
    film(left, right, time.time_ns() - 2 * SECOND, live, surveyed_live)
    for consumer in consumers:
        consumer.join(30)
    assert (len(live), len(surveyed_live)) == (FRAMES + 2, FRAMES + 1)
    for speed in (0, 0, 0, 0, 0, 4.0, 4.0, 4.0, 1.0, 1.0):
        with rt.replay(start, speed=speed) as replay:
            assert depth(replay, []) == live
        with rt.replay(start, speed=speed) as replay:
            assert surveyed(replay, []) == surveyed_live


def test_blocking_reads_move_the_clock_to_the_instant_of_their_answer(rt: st.Connection) -> None:
    channel, start = rt.channel("clock/reads", max_age="60s", archive="7d"), st.now() - SECOND
    start = channel.stats().host_time
    for number in range(5):
        channel.put(b"%d" % number, time=start + number * MS)
    instants = []
    with rt.replay(start, speed=0) as replay:
        seen, found = replay.channel("clock/reads"), []
        assert seen.newest() is None
        item = seen.newest(timeout=10)
        while item is not None:
            assert seen.newest() == item  # the clock stands still between two waits
            found.append(item.payload)
            instants.append(replay.now)
            item = seen.newest(after=item, timeout=1)
    assert found == [b"0", b"1", b"2", b"3", b"4"]
    assert instants == sorted(instants)
    assert [channel.newest(as_of=instant).payload for instant in instants] == found


def test_a_subscription_gives_the_items_in_the_order_of_their_acceptance(rt: st.Connection) -> None:
    channel, began = rt.channel("clock/items", max_age="60s", archive="7d"), st.now() - SECOND
    channel.put(b"held", time=began)
    start = channel.stats().host_time
    for payload, at in ((b"a", 10), (b"c", 30), (b"late", 20), (b"d", 40)):
        channel.put(payload, time=began + at * MS)
    with rt.replay(start, speed=0) as replay:
        seen = replay.channel("clock/items")
        with seen.subscribe() as items:
            assert [item.payload for item in items] == [b"a", b"c", b"late", b"d"]
        assert [item.payload for item in seen.get(st.OLDEST, st.NOW)] == [b"held", b"a", b"late", b"c", b"d"]
    with rt.replay(start, speed=0) as replay, replay.channel("clock/items").subscribe(start=began) as items:
        assert [item.payload for item in items] == [b"held", b"a", b"c", b"late", b"d"]


def test_a_subscription_holds_few_of_many_earlier_pages(rt: st.Connection, monkeypatch: pytest.MonkeyPatch) -> None:
    channel, began = rt.channel("clock/earlier", max_items=5, archive="7d"), st.now() - SECOND
    # Some items are out of order, and two may have the same time.
    times = [at + 7 * (at % 11 == 3) for at in range(300)]
    for number, at in enumerate(times):
        channel.put(b"%d" % number, time=began + at * MS)
    start = channel.stats().host_time
    channel.put(b"later", time=began + 400 * MS)
    for name, least in (("KEYS_PER_PAGE", 64), ("PAGE_ITEMS_MAX", 32)):
        monkeypatch.setattr(earlier_pages, name, least)
    with rt.replay(start, speed=0) as replay, replay.channel("clock/earlier").subscribe(start=began) as items:
        accepted = [item.payload for item in channel.get(st.OLDEST, st.NOW)]
        found = [(item.payload, len(items._ready)) for item in items]
    assert [payload for payload, _ in found] == [*sorted(accepted[:-1], key=int), b"later"]
    assert max(waiting for _, waiting in found) < 32
    monkeypatch.setattr(earlier_pages, "KEYS_MAX", 200)
    with (
        rt.replay(start, speed=0) as replay,
        replay.channel("clock/earlier").subscribe(start=began) as items,
        pytest.raises(st.Overloaded, match="later start="),
    ):
        next(items)


def test_a_missing_channel_or_group_is_named_with_a_remedy_that_a_replay_has(rt: st.Connection) -> None:
    with rt.replay(st.now(), speed=0) as replay:
        with pytest.raises(st.ChannelNotFound, match="no channel nobody, and a replay creates none"):
            replay.channel("nobody")
        with pytest.raises(st.GroupNotFound, match="create it through the connection"):
            replay.group("nobody", [])


def test_a_stepped_replay_clock_moves_only_by_steps(rt: st.Connection) -> None:
    channel = rt.channel("clock/steps", max_age="60s", archive="7d")
    start = channel.stats().host_time
    channel.put(b"one")
    end = channel.stats().host_time
    with rt.replay(start, step=True) as replay:
        seen, found = replay.channel("clock/steps"), []
        reader = threading.Thread(target=lambda: found.append(seen.newest(timeout=10)))
        reader.start()
        assert seen.newest() is None
        assert replay.now == start
        replay.step(f"{end - start} ns")
        reader.join(10)
        assert [item.payload for item in found] == [b"one"]
        assert replay.now == end


@pytest.mark.parametrize("closes", ["replay", "connection"])
def test_a_close_ends_a_read_that_waits_for_the_clock(cluster: LocalCluster, closes: str) -> None:
    with st.connect(cluster.address, secret=cluster.secret.text) as rt, ThreadPoolExecutor(1) as pool:
        channel = rt.channel(f"clock/close/{closes}", max_age="60s", archive="7d")
        start = channel.stats().host_time
        channel.put(b"one")
        replay = rt.replay(start, step=True)
        seen = replay.channel(f"clock/close/{closes}")
        waits, entered = replay._clock._left_s, threading.Event()
        replay._clock._left_s = lambda instant: (entered.set(), waits(instant))[1]  # type: ignore[method-assign]
        reading = pool.submit(seen.newest, timeout=None)
        assert entered.wait(30)
        (replay if closes == "replay" else rt).close()
        with pytest.raises(st.Unavailable, match="closed"):
            reading.result(30)


def test_a_replay_ends_at_its_stated_end(rt: st.Connection) -> None:
    channel = rt.channel("clock/end", max_age="60s", archive="7d")
    start = channel.stats().host_time
    channel.put(b"one")
    end = channel.stats().host_time
    channel.put(b"two")
    with rt.replay(start, end, speed=0) as replay:
        seen = replay.channel("clock/end")
        assert [item.payload for item in seen.subscribe()] == [b"one"]
        assert seen.newest(after=seen.newest(), timeout=5) is None
        with pytest.raises(st.DeadlineExceeded, match="the replay has ended"):
            seen.newest(after=seen.newest(), timeout=None)
        with pytest.raises(st.InvalidArgument, match="mode"):
            replay.channel("clock/end").subscribe(mode="latest")


def test_a_replayed_match_whose_items_wait_too_long_fails_instead_of_taking_all_memory(
    rt: st.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    fast, slow = (rt.channel(f"clock/{name}", max_age="60s", archive="7d") for name in ("fast", "slow"))
    start = fast.stats().host_time
    for number in range(8):
        fast.put(bytes(1000), time=start + number * MS)
    rt.group("clock-bound", [fast, slow])
    monkeypatch.setattr("stampede_rt._sync.archived_matching.KEYS_MAX", 5)
    with rt.replay(start, speed=0) as replay, replay.group("clock-bound").match("clock/fast", "1ms") as matches:
        with pytest.raises(st.Overloaded, match="until channel 'clock/slow' has passed their times"):
            next(matches)
        assert (matches.unmatched, matches.dropped) == (0, 0)


class RecordedPair:
    """Two recorded channels of a group, whose second channel is a little behind, and the start of their recording."""

    def __init__(self, rt: st.Connection, name: str) -> None:
        self.left, self.right = (rt.channel(f"{name}/{side}", max_age="60s", archive="7d") for side in "lr")
        self.group = rt.group(name, [self.left, self.right])
        self.start = self.left.stats().host_time
        self.began = self.start - SECOND
        for number in range(8):
            self.left.put(b"l%d" % number, time=self.began + number * 10 * MS)
            if number == 5:
                self.right.put(b"late", time=self.began + 31 * MS)
            self.right.put(b"r%d" % number, time=self.began + number * 10 * MS + MS)
        self.end = self.left.stats().host_time


def test_a_program_reads_through_a_replayed_group_as_through_a_live_one(rt: st.Connection) -> None:
    pair = RecordedPair(rt, "replayed-group")
    with pair.group[pair.right].subscribe(start=st.OLDEST) as items:
        live = [next(items).payload for _ in range(8)]
    with rt.replay(pair.end, speed=0) as replay:  # the replay shows all items immediately
        group = replay.group("replayed-group")
        assert [item.payload for item in group["replayed-group/r"].subscribe(start=st.OLDEST)] == live
        assert len(group) == 2
        assert [one.newest().payload for one in group] == [b"l6", b"r6"]
        third = pair.right.get(pair.began + 21 * MS, pair.began + 21 * MS, match="start")[0]
        after = [item.payload for item in group[pair.right].subscribe(after=third)]
        assert after == live[3:]
    with rt.replay(pair.start, speed=0) as replay:  # the replay shows the items bit by bit
        found, shown, item = [], replay.group("replayed-group")[pair.left], None
        while (item := shown.newest(after=item, timeout=1)) is not None:
            found.append((item.payload, replay.now))
        assert [payload for payload, _ in found] == [b"l%d" % number for number in range(7)]
        for payload, instant in found:
            assert pair.group[pair.left].newest(as_of=instant).payload == payload
            assert getattr(pair.group[pair.left].newest(as_of=instant - 1), "payload", None) != payload
    with rt.replay(pair.start, speed=0) as replay:
        items = replay.group("replayed-group")[pair.right].subscribe()
        assert [item.payload for item in items] == [b"r0", b"r1", b"r2", b"r3", b"late", b"r4", b"r5", b"r6"]


@pytest.mark.parametrize("unique", [False, True])
def test_replayed_matches_begin_with_earlier_items_and_continue(rt: st.Connection, unique: bool) -> None:
    pair = RecordedPair(rt, f"replayed-matches-{unique}")
    how: dict[str, Any] = {"tolerance": "15ms", "unique": unique, "start": pair.began + 20 * MS, "partial": True}
    with pair.group.match(pair.left, **how) as matches:
        live = [[item.payload for item in one.values()] for one in islice(matches, 4)]
    # `too_early`: the number of items that come after the match has begun, with times before its start.
    for start, too_early in (
        (pair.end, 0),
        (pair.start, 2),
    ):
        with rt.replay(start, speed=0) as replay, replay.group(pair.group.name).match(pair.left, **how) as matches:
            found = [[item.payload for item in one.values()] for one in matches]
            assert (matches.unmatched, matches.dropped, matches.reason, matches.losses) == (0, too_early, None, 0)
        assert found == live


def test_a_replayed_channel_calls_functions_and_gives_the_newest_items(rt: st.Connection) -> None:
    channel = rt.channel("clock/calls", max_age="60s", archive="7d")
    start = channel.stats().host_time
    for number in range(5):
        channel.put(b"%d" % number)
    last, found = channel.newest(), []
    with rt.replay(start, speed=0) as replay:
        listener = replay.channel("clock/calls").on_item(lambda item: found.append(item.payload))
        assert listener.join(30)
        assert (listener.error, listener.active, listener.dropped, listener.reconnects) == (None, False, 0, 0)
    assert found == [b"0", b"1", b"2", b"3", b"4"]
    with rt.replay(start, speed=0) as replay:
        seen, found = replay.channel("clock/calls"), []
        with seen.subscribe(mode="newest") as newest:
            for item in newest:
                found.append(item.payload)
                while item.payload == b"1" and replay.now < last.time:
                    replay.sleep("1ms")  # other items come in this time
            assert (found, newest.skipped) == ([b"0", b"1", b"4"], 2)
        with seen.subscribe(after=channel.get(st.OLDEST, st.NOW)[2]) as rest:
            assert [item.payload for item in rest] == [b"3", b"4"]


def test_the_error_for_a_name_that_a_replay_lacks_says_why_and_a_wrong_argument_is_refused(rt: st.Connection) -> None:
    channel = rt.channel("clock/lacks", max_age="60s", archive="7d")
    with rt.replay(channel.stats().host_time) as replay:
        with pytest.raises(AttributeError, match="changes nothing"):
            replay.channel("clock/lacks").put(b"x")
        with pytest.raises(AttributeError, match="not recorded"):
            replay.queue("jobs")
        with pytest.raises(TypeError, match="max_ages"):
            replay.channel("clock/lacks", max_ages="60s")
        assert replay.channel("clock/lacks", max_age="60s", archive="7d") == replay.channel("clock/lacks")


def test_a_connection_has_the_clock_of_a_replay(rt: st.Connection) -> None:
    before = rt.now
    rt.sleep("1ms")
    assert before + MS <= rt.now <= time.time_ns()


@pytest.mark.parametrize("arguments", [{"speed": -1}, {"speed": "fast"}, {"end": 5}, {"step": 1}])
def test_a_replay_with_wrong_arguments_is_refused(rt: st.Connection, arguments: dict[str, Any]) -> None:
    with pytest.raises(st.InvalidArgument):
        rt.replay(10, **arguments)


def test_the_asyncio_client_replays_like_the_blocking_client(cluster: LocalCluster) -> None:
    async def replayed() -> list[bytes]:
        async with aio.connect(cluster.address, secret=cluster.secret.text) as rt:
            channel = await rt.channel("clock/aio", max_age="60s", archive="7d")
            start = (await channel.stats()).host_time
            for number in range(3):
                await channel.put(b"%d" % number)
            found = []
            async with rt.replay(start, speed=0) as replay:
                seen = await replay.channel("clock/aio")
                item = await seen.newest(timeout=5)
                while item is not None:
                    found.append(item.payload)
                    item = await seen.newest(after=item, timeout=1)
            return found

    assert asyncio.run(replayed()) == [b"0", b"1", b"2"]
