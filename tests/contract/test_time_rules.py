"""Rules of docs/time-model.md that the other files of this folder leave out: instants, spans, bounds, absence."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

import stampede_rt as st
from tests.contract.surfaces import Surface
from tests.contract.test_reads import filled, shown
from tests.support.waiting import pause

MS = 1_000_000
SECOND = 1_000 * MS
SOON_S = 20  # on any machine, an immediate answer comes within this time, which is much shorter than LONG_S
LONG_S = 3_600


async def run_to_end(get: Any) -> Any:
    """Return the answer of a get that must not wait until its timeout."""
    async with asyncio.timeout(SOON_S):
        return await get


# --- instants and durations


async def test_an_instant_is_an_int_or_a_datetime_with_its_timezone(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    time = datetime.now(UTC) - timedelta(seconds=1)
    item = await channel.put(b"x", time=time)
    assert item.time == int(time.timestamp()) * SECOND + time.microsecond * 1_000
    assert shown(await channel.at(time)) == ["x"]


@pytest.mark.parametrize("lossy", [1.7e9, datetime(2026, 1, 1), "2026-01-01", True])
async def test_a_float_a_text_or_a_datetime_without_timezone_is_refused_as_an_instant(
    surface: Surface, lossy: Any
) -> None:
    channel = await surface.channel()
    with pytest.raises(st.InvalidArgument):
        await channel.put(b"x", time=lossy)


async def test_a_policy_and_an_offset_state_their_unit(surface: Surface) -> None:
    with pytest.raises(st.InvalidArgument, match="unit"):
        await surface.channel(max_age=10)
    with pytest.raises(st.InvalidArgument, match="unit"):
        _ = st.NOW - 10  # type: ignore[operator]


async def test_an_open_interval_between_two_adjacent_nanoseconds_is_not_empty(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10)
    assert shown(await channel.get(base + 5, base + 6, bounds="()")) == ["0"]
    empty = await channel.get(base + 5, base + 5, bounds="[)")
    assert (len(empty), empty.reason, empty.complete) == (0, st.Reason.NEVER, True)


# --- spans


async def test_a_late_item_is_found_by_its_time_and_ends_the_span_before_it(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 100)
    (before,) = await channel.at(base + 50 * MS)
    await channel.put(b"late", time=base + 40 * MS)
    (first,) = await channel.at(base)
    assert (before.end, first.end) == (base + 100 * MS, base + 40 * MS)
    assert shown(await channel.at(base + 50 * MS)) == ["late"]


async def test_the_next_item_ends_a_span_before_its_duration_does(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - SECOND
    await channel.put(b"long", time=base, duration="500ms")
    await channel.put(b"next", time=base + 10 * MS)
    (item,) = await channel.at(base)
    assert (item.duration, item.end) == (500 * MS, base + 10 * MS)
    assert shown(await channel.at(base + 10 * MS)) == ["next"]


async def test_the_span_of_the_newest_item_ends_after_its_duration(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    await channel.put(b"x", time=st.now() - SECOND, duration="10ms")
    assert shown(await channel.at(st.NOW)) == []


# --- bounds and meta-times


async def test_now_is_never_before_the_newest_item(surface: Surface) -> None:
    channel = await surface.channel(max_future="1h")
    ahead = st.now() + 600 * SECOND
    await channel.put(b"ahead", time=ahead)
    items = await channel.get(st.NOW - "1s", st.NOW)
    assert (shown(items), items.interval.end) == (["ahead"], ahead)


async def test_a_read_after_the_last_item_never_returns_that_item_again(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10)
    last = (await channel.get(base, st.NOW, match="start"))[-1]
    assert shown(await channel.get(last.time, st.NOW, bounds="(]", match="start")) == []
    await channel.put(b"new", time=base + 20 * MS)
    assert shown(await channel.get(last.time, st.NOW, bounds="(]", match="start")) == ["new"]


async def test_an_interval_up_to_now_contains_the_whole_span_of_the_newest_item(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10)
    assert shown(await channel.get(base, st.NOW, match="whole")) == ["0", "10"]
    assert shown(await channel.get(base, base + 20 * MS, match="whole")) == ["0"]


async def test_a_resolved_bound_does_not_change_while_a_get_waits(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10)
    get = asyncio.ensure_future(channel.get(st.OLDEST, st.NEWEST, complete=True, match="start", timeout=SOON_S))
    await waiting(channel)
    await channel.put(b"20", time=base + 20 * MS)
    items = await get
    assert (shown(items), items.interval.end) == (["0", "10"], base + 10 * MS)


async def test_bounds_relative_to_items_are_resolved_when_the_first_item_arrives(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    get = asyncio.ensure_future(channel.get(st.OLDEST - "5ms", st.NEWEST, timeout=SOON_S))
    await waiting(channel)
    time = (await channel.put(b"first")).time
    interval = (await get).interval
    assert (interval.start, interval.end) == (time - 5 * MS, time)


# --- blocking


async def waiting(channel: Any, count: int = 1) -> None:
    """Wait until `count` gets are blocked on the channel, for at most 20 s."""
    async with asyncio.timeout(SOON_S):
        while (await channel.stats()).waiting_gets < count:
            await pause()


async def test_a_get_with_a_future_start_is_answered_when_the_start_arrives(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    await channel.put(b"holds")
    items = await run_to_end(channel.get(st.NOW + "60ms", st.NOW + "1h", timeout=LONG_S))
    assert shown(items) == ["holds"]


async def test_a_waiting_get_is_answered_only_by_an_item_in_its_interval(surface: Surface) -> None:
    channel, base = await filled(surface, 0)
    interval = base + 100 * MS, base + 200 * MS
    get = asyncio.ensure_future(channel.get(*interval, match="start", timeout=SOON_S))
    await waiting(channel)
    await channel.put(b"before", time=base + 50 * MS)
    await channel.advance(base + 60 * MS)
    assert (await channel.stats()).waiting_gets == 1
    await channel.put(b"inside", time=base + 150 * MS)
    assert shown(await get) == ["inside"]


async def test_a_later_item_ends_a_waiting_get_whose_interval_stays_empty(surface: Surface) -> None:
    channel, base = await filled(surface, 0)
    get = asyncio.ensure_future(channel.get(base + 10 * MS, base + 20 * MS, match="start", timeout=SOON_S))
    await waiting(channel)
    await channel.put(b"behind", time=base + 30 * MS)
    items = await get
    assert (len(items), items.reason, items.complete) == (0, st.Reason.NEVER, True)


async def test_an_interval_with_an_inclusive_end_is_complete_only_after_a_strictly_later_item(surface: Surface) -> None:
    channel, base = await filled(surface, 0)
    end = base + 20 * MS
    get = asyncio.ensure_future(channel.get(base, end, match="start", complete=True, timeout=SOON_S))
    await waiting(channel)
    await channel.put(b"at", time=end)
    assert (await channel.stats()).waiting_gets == 1
    await channel.put(b"behind", time=end + 1)
    assert shown(await get) == ["0", "at"]


async def test_a_get_of_a_collected_interval_is_answered_immediately_however_long_the_timeout(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10, 20, 30, max_items=2, max_age=None)
    get = channel.get(base, base + 5 * MS, match="start", complete=True, timeout=LONG_S)
    items = await run_to_end(get)
    assert (len(items), items.reason, items.complete) == (0, st.Reason.COLLECTED, True)


# --- why an answer is empty or partial


@pytest.mark.parametrize(
    ("policy", "times"),
    [({"max_items": 1, "max_age": None}, (0, 10, 20)), ({"max_bytes": 70, "max_age": None}, (0, 10, 20))],
)
async def test_an_empty_answer_names_the_limit_that_collected_the_items(
    surface: Surface, policy: dict[str, Any], times: tuple[int, ...]
) -> None:
    channel, base = await filled(surface, *times, **policy)
    items = await channel.get(base, base + 5 * MS)
    assert (len(items), items.reason) == (0, st.Reason.COLLECTED)
    assert next(iter(policy)) in items.reason.detail


async def test_an_empty_answer_names_the_age_that_collected_the_items(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10, 1_900)
    await channel.configure(max_age="1s")
    items = await channel.get(base, base + 5 * MS)
    assert (len(items), items.reason) == (0, st.Reason.COLLECTED)
    assert "max_age (1 s)" in items.reason.detail


async def test_the_frontier_is_the_latest_collected_end_and_never_above_a_held_item(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10, 20, 30, max_items=2, max_age=None)
    assert (await channel.stats()).frontier == base + 20 * MS
    items = await channel.get(base + 19 * MS, st.NEWEST)
    assert (items.truncated, items.reason, shown(items)) == (True, st.Reason.COLLECTED, ["20", "30"])
    assert not (await channel.get(base + 20 * MS, st.NEWEST)).truncated


async def test_an_item_whose_span_ends_after_the_largest_instant_can_be_collected(surface: Surface) -> None:
    channel = await surface.channel(max_items=5)
    await channel.put(b"for ever", duration=2**63 - 1)
    await channel.configure(max_bytes=64)
    stats = await channel.stats()
    assert (stats.accepted, stats.held, stats.frontier is None) == (1, 0, False)


async def test_an_interval_whose_items_can_still_come_is_answered_with_not_yet(surface: Surface) -> None:
    channel, _ = await filled(surface, 0)
    items = await channel.get(st.NOW + "1h", st.NOW + "2h")
    assert (len(items), items.reason, items.complete) == (0, st.Reason.NOT_YET, False)


async def test_an_advance_makes_an_empty_interval_complete(surface: Surface) -> None:
    channel, base = await filled(surface, 0)
    await channel.advance(base + 30 * MS)
    items = await channel.get(base + 10 * MS, base + 20 * MS, match="start")
    assert (len(items), items.reason, items.complete) == (0, st.Reason.NEVER, True)


# --- retention


async def test_a_read_within_max_age_is_never_truncated(surface: Surface) -> None:
    channel, _ = await filled(surface, -98_000, -78_000, -43_000, 0, max_age="50s")
    items = await channel.get(*st.last("40s"))
    assert (shown(items)[-2:], items.truncated) == (["-43000", "0"], False)


async def test_the_default_max_age_is_ten_seconds(surface: Surface) -> None:
    channel = await surface.channel()
    await channel.put(b"newest", time=st.now() - 11 * SECOND)
    with pytest.raises(st.TooOld, match="max_age"):
        await channel.put(b"x", time=st.now() - 12 * SECOND)


async def test_a_given_limit_replaces_the_default_max_age(surface: Surface) -> None:
    channel = await surface.channel(max_items=2)
    await channel.put(b"newest", time=st.now() - 3_600 * SECOND)
    await channel.put(b"older", time=st.now() - 7_200 * SECOND)
    assert (await channel.stats()).held == 2


async def test_a_put_older_than_collected_items_is_too_old(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10, 20, max_items=2, max_age=None)
    await channel.configure(max_items=5)
    with pytest.raises(st.TooOld, match="collected"):
        await channel.put(b"x", time=base - MS)
    assert (await channel.put(b"x", time=base + 15 * MS)).seq == 4


async def test_max_future_says_how_far_ahead_a_clock_may_be(surface: Surface) -> None:
    channel = await surface.channel(max_future="1h")
    await channel.put(b"x", time=st.now() + 1_800 * SECOND)
    with pytest.raises(st.InFuture, match="max_future"):
        await channel.put(b"x", time=st.now() + 5_400 * SECOND)


async def test_a_put_that_could_wait_forever_is_refused(surface: Surface) -> None:
    with pytest.raises(st.InvalidArgument, match="for ever"):
        await (await surface.channel(max_items=1, on_full="block")).put(b"x")


async def test_a_handle_opened_before_on_full_became_block_waits(surface: Surface) -> None:
    channel = await surface.channel(max_items=1, max_age="2500ms", on_full="reject")
    await channel.put(b"first")
    await channel.configure(on_full="block")
    assert (await run_to_end(channel.put(b"second"))).payload == b"second"


async def test_a_handle_opened_before_on_full_became_reject_refuses_puts(surface: Surface) -> None:
    channel = await surface.channel(max_items=1, max_age="60s", on_full="block")
    await channel.put(b"first")
    await channel.configure(on_full="reject")
    with pytest.raises(st.ChannelFull):
        await run_to_end(channel.put(b"second"))


async def test_changed_limits_apply_immediately(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 10, 20, 30)
    await channel.configure(max_items=2)
    assert shown(await channel.get(st.OLDEST, st.NEWEST)) == ["20", "30"]
    await channel.configure(max_items=10)
    assert shown(await channel.get(st.OLDEST, st.NEWEST)) == ["20", "30"]


# --- identity and subscriptions


async def test_a_position_of_another_incarnation_is_refused(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 10)
    item = await channel.oldest()
    with pytest.raises(st.IncarnationLost):
        await channel.get(st.OLDEST, st.NEWEST, after=item._replace(incarnation=item.incarnation ^ 2))


async def test_a_newest_subscription_counts_skipped_items(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10, 20)
    async with channel.subscribe(start=base, mode="newest") as items:
        assert (await anext(items)).payload == b"20"
        async with asyncio.timeout(SOON_S):
            step = asyncio.ensure_future(anext(items))
            while items.skipped < 2:
                await channel.stats()
            await channel.put(b"30", time=base + 30 * MS)
            assert (await step).payload == b"30"
