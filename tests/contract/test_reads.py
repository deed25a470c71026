"""The time model's rules of reading, on every surface (docs/time-model.md)."""

from __future__ import annotations

import pytest

import stampede_rt as st
from tests.contract.surfaces import Surface

MS = 1_000_000


async def filled(surface: Surface, *times: int, **policy: object) -> tuple[object, int]:
    """Return a channel with an item at each of `times` (milliseconds after a base two seconds ago), and the base."""
    channel = await surface.channel(**({"max_age": "60s"} | policy))
    base = st.now() - 2_000 * MS
    for time in times:
        await channel.put(str(time).encode(), time=base + time * MS)
    return channel, base


def shown(items: object) -> list[str]:
    return [item.payload.decode() for item in items]


async def test_an_item_keeps_the_time_and_attributes_of_its_producer(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s", content_type="text/plain")
    time = st.now() - 5 * MS
    put = await channel.put(b"hello", time=time, duration="33ms", attributes={"enc": "none"})
    item = await channel.newest()
    assert (item.time, item.duration, item.payload, item.content_type) == (time, 33 * MS, b"hello", "text/plain")
    assert item.attributes == {"enc": "none"}
    assert item.end == time + 33 * MS
    assert (put.time, put.seq) == (item.time, item.seq)


async def test_a_put_without_a_time_is_stamped_when_accepted(surface: Surface) -> None:
    channel = await surface.channel()
    before = st.now()
    item = await channel.put(b"x")
    assert before - 50 * MS <= item.time <= st.now() + 50 * MS


async def test_items_are_ordered_by_time_and_not_by_arrival(surface: Surface) -> None:
    channel, _ = await filled(surface, 30, 10, 20, 40, 0)
    assert shown(await channel.get(st.OLDEST, st.NEWEST)) == ["0", "10", "20", "30", "40"]


async def test_items_with_equal_times_are_all_kept_in_one_bucket(surface: Surface) -> None:
    channel, base = await filled(surface, 10, 10, 10, 20)
    items = await channel.get(base + 10 * MS, base + 10 * MS)
    assert [item.seq for item in items] == sorted(item.seq for item in items)
    assert len(items) == 3
    assert {item.end for item in items} == {base + 20 * MS}


async def test_the_span_of_an_item_ends_at_the_next_item(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 100)
    assert shown(await channel.at(base)) == ["0"]
    assert shown(await channel.at(base + 99 * MS)) == ["0"]
    assert shown(await channel.at(base + 100 * MS)) == ["100"]


async def test_the_span_of_the_newest_item_ends_at_now(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 100)
    assert shown(await channel.at(st.NOW)) == ["100"]
    assert shown(await channel.at(st.now() + 3_600_000 * MS)) == []


async def test_a_duration_ends_a_span_before_the_next_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    await channel.put(b"short", time=base, duration="10ms")
    await channel.put(b"next", time=base + 100 * MS)
    assert shown(await channel.at(base + 9 * MS)) == ["short"]
    assert shown(await channel.at(base + 10 * MS)) == []


async def test_a_later_item_does_not_shorten_a_duration_with_overlap(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s", overlap="400ms")
    base = st.now() - 2_000 * MS
    await channel.put(b"scene", time=base, duration="300ms")
    await channel.put(b"open", time=base + 50 * MS)
    await channel.put(b"talk", time=base + 100 * MS, duration="900ms")
    await channel.put(b"end", time=base + 600 * MS)
    assert shown(await channel.at(base + 60 * MS)) == ["scene", "open"]
    # The span of an item without a duration ends as in other channels.
    assert shown(await channel.at(base + 200 * MS)) == ["scene", "talk"]
    assert shown(await channel.at(base + 300 * MS)) == ["talk"]
    assert shown(await channel.at(base + 600 * MS)) == ["end"]  # "talk" has lasted for the overlap, so its span ends
    found = await channel.get(base, base + 1_000 * MS, match="start")
    assert [item.end and item.end - base for item in found] == [300 * MS, 100 * MS, 600 * MS, None]
    assert shown(await channel.get(base, base + 299 * MS, match="whole")) == ["open"]
    assert shown(await channel.get(base, base + 300 * MS, match="whole")) == ["scene", "open"]
    assert shown(await channel.get(base + 250 * MS, base + 260 * MS, limit=1, newest_first=True)) == ["talk"]


async def test_an_item_outside_the_answer_still_ends_the_span_before_it_with_overlap(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s", overlap="90ms")
    base = st.now() - 2_000 * MS
    await channel.put(b"open", time=base)
    await channel.put(b"long", time=base + 100 * MS, duration="90ms")  # past the end of the interval
    await channel.put(b"short", time=base + 110 * MS, duration="10ms")
    for newest_first in (False, True):
        found = await channel.get(base, base + 150 * MS, match="whole", newest_first=newest_first)
        ends = {shown([item])[0]: item.end and item.end - base for item in found}
        assert ends == {"open": 100 * MS, "short": 120 * MS}
    long = await surface.channel(max_age="60s", overlap="90ms")
    await long.put(b"scene", time=base, duration="200ms")
    await long.put(b"brief", time=base + 50 * MS, duration="1ms")  # over before the interval
    await long.put(b"later", time=base + 150 * MS)
    found = await long.get(base + 70 * MS, base + 160 * MS)
    assert [(shown([item])[0], item.end and item.end - base) for item in found] == [("scene", 90 * MS), ("later", None)]


async def test_ages_count_from_the_longest_possible_end_with_overlap(surface: Surface) -> None:
    channel = await surface.channel(max_age="1s", overlap="3600s")
    base = st.now() - 3_000 * MS
    for number in range(3):
        await channel.put(b"%d" % number, time=base + number * MS, duration="1ms")
    assert shown(await channel.get(st.OLDEST, st.NEWEST)) == ["0", "1", "2"]


async def test_an_item_with_a_duration_of_zero_is_valid_at_one_instant(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    await channel.put(b"event", time=base, duration="0s")
    assert shown(await channel.at(base)) == ["event"]
    assert shown(await channel.at(base + 1)) == []


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [("[]", ["10", "20", "30"]), ("[)", ["10", "20"]), ("(]", ["20", "30"]), ("()", ["20"])],
)
async def test_each_bound_is_inclusive_or_exclusive(surface: Surface, bounds: str, expected: list[str]) -> None:
    channel, base = await filled(surface, 0, 10, 20, 30, 40)
    items = await channel.get(base + 10 * MS, base + 30 * MS, bounds=bounds, match="start")
    assert shown(items) == expected


async def test_partly_contained_items_are_returned_whole(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 100, 200)
    assert shown(await channel.get(base + 50 * MS, base + 150 * MS)) == ["0", "100"]


async def test_match_whole_returns_only_items_inside_the_interval(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 100, 200, 300)
    assert shown(await channel.get(base + 50 * MS, base + 300 * MS, match="whole")) == ["100", "200"]


async def test_adjoining_half_open_intervals_return_every_item_once(surface: Surface) -> None:
    channel, base = await filled(surface, *range(0, 100, 7))
    found = []
    for start in range(0, 100, 10):
        ends = base + start * MS, base + (start + 10) * MS
        found += shown(await channel.get(*ends, bounds="[)", match="start"))
    assert found == [str(time) for time in range(0, 100, 7)]


async def test_a_meta_time_can_have_an_offset(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 10, 20, 30)
    assert shown(await channel.get(st.NEWEST - "10ms", st.NEWEST, match="start")) == ["20", "30"]
    assert shown(await channel.get(st.OLDEST, st.OLDEST + "10ms", match="start")) == ["0", "10"]


async def test_the_last_seconds_are_an_interval_up_to_now(surface: Surface) -> None:
    channel, _ = await filled(surface, -38_000, 1_900)
    assert shown(await channel.get(*st.last("30s"), match="start")) == ["1900"]


async def test_a_get_returns_the_interval_with_resolved_bounds(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 30)
    items = await channel.get(st.NEWEST - "10ms", st.NEWEST)
    assert (items.interval.start, items.interval.end) == (base + 20 * MS, base + 30 * MS)


async def test_before_returns_the_newest_older_item_and_the_last_one_of_its_bucket(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10, 10, 20)
    item = await channel.before(base + 20 * MS)
    bucket = await channel.get(base + 10 * MS, base + 10 * MS)
    assert item == bucket[-1]
    assert await channel.before(base) is None


async def test_oldest_returns_the_first_item_of_its_bucket_and_newest_the_last(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 0, 10, 10)
    items = await channel.get(st.OLDEST, st.NEWEST)
    assert (await channel.oldest(), await channel.newest()) == (items[0], items[-1])


async def test_newest_after_an_item_returns_a_strictly_later_item(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10)
    newest = await channel.newest()
    assert await channel.newest(after=newest) is None
    assert await channel.newest(after=base + 10 * MS) is None
    assert await channel.newest(after=base) == newest
    await channel.put(b"again", time=base + 10 * MS)
    assert (await channel.newest(after=newest)).payload == b"again"


async def test_a_limit_keeps_the_earliest_items_and_the_next_page_continues(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 10, 10, 20, 30)
    found, after = [], None
    while True:
        page = await channel.get(st.OLDEST, st.NEWEST, limit=2, after=after)
        found += shown(page)
        if not page.more:
            break
        after = page[-1]
    assert found == ["0", "10", "10", "20", "30"]


async def test_newest_first_reverses_the_order_and_the_next_page_continues(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 10, 10, 20, 30)
    first = await channel.get(st.OLDEST, st.NEWEST, limit=3, newest_first=True)
    rest = await channel.get(st.OLDEST, st.NEWEST, newest_first=True, after=first[-1])
    assert shown(first) + shown(rest) == ["30", "20", "10", "10", "0"]
    assert first.more
    assert not rest.more


async def test_a_read_does_not_change_the_channel(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 10)
    assert shown(await channel.get(st.OLDEST, st.NEWEST)) == shown(await channel.get(st.OLDEST, st.NEWEST))


async def test_a_read_without_payloads_has_their_lengths(surface: Surface) -> None:
    channel, _ = await filled(surface, 0, 10)
    items = await channel.get(st.OLDEST, st.NEWEST, payloads=False)
    assert [item.payload for item in items] == [None, None]
    assert [item.payload_length_bytes for item in items] == [1, 2]


async def test_an_interval_that_ends_before_its_start_is_refused_with_both_bounds(surface: Surface) -> None:
    channel, base = await filled(surface, 0)
    with pytest.raises(st.InvalidInterval, match=f"{base + 1}.*{base}"):
        await channel.get(base + 1, base)


async def test_an_interval_is_empty_if_its_meta_times_resolve_in_reverse_order(surface: Surface) -> None:
    channel, _ = await filled(surface, 0)
    assert len(await channel.get(st.NEWEST + "1ms", st.NEWEST)) == 0


async def test_an_empty_channel_answers_not_yet(surface: Surface) -> None:
    channel = await surface.channel()
    items = await channel.get(st.OLDEST, st.NEWEST)
    assert (len(items), items.reason, items.interval) == (0, st.Reason.NOT_YET, None)
    assert items.reason.detail


async def test_a_finished_interval_without_items_is_answered_with_never(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 2_000 * MS
    await channel.put(b"a", time=base, duration="1ms")
    await channel.put(b"b", time=base + 100 * MS)
    items = await channel.get(base + 50 * MS, base + 60 * MS)
    assert (len(items), items.reason, items.complete) == (0, st.Reason.NEVER, True)


async def test_an_empty_answer_names_the_policy_that_collected_the_items(surface: Surface) -> None:
    channel, base = await filled(surface, 0, 10, 20, 30, max_items=2, max_age=None)
    items = await channel.get(base, base + 5 * MS, match="start")
    assert (len(items), items.reason) == (0, st.Reason.COLLECTED)
    assert "max_items" in items.reason.detail
    assert (await channel.get(base, st.NEWEST)).truncated
