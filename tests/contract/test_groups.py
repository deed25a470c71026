"""Groups and cross-sections on real hosts, with both clients. Every process finds a group that another process
makes.
"""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.contract.surfaces import Surface, connected, take

MS = 1_000_000
SECOND = 1_000 * MS

_names = itertools.count()


@pytest.fixture(params=["aio", "sync"])
async def surface(request: pytest.FixtureRequest, grouped_cluster: LocalCluster) -> AsyncIterator[Surface]:
    async with connected(request.param, grouped_cluster.address) as surface:
        yield surface


async def two_channels(surface: Surface, **policy: Any) -> tuple[Any, Any]:
    """Return two channels, one at each host."""
    hosts = await surface.connection.hosts()
    left, right = [await surface.channel(host=host.name, **({"max_age": "60s"} | policy)) for host in hosts]
    return left, right


def group_name() -> str:
    return f"contract/{next(_names)}-{st.now()}"


async def test_a_group_is_found_by_its_name_with_its_settings(surface: Surface) -> None:
    left, right = await two_channels(surface)
    name = group_name()
    made = await surface.group(name, [left, right], reference=left, bound="end", idle_after="2s", max_lead="1s")
    found = await surface.group(name)
    assert found.info == made.info
    assert [channel.name for channel in found.channels] == [left.name, right.name]
    assert (found.info.bound, found.info.idle_after_nanos, found.info.max_lead_nanos) == ("end", 2 * SECOND, SECOND)
    assert found.info.reference_id == left.info.channel_id
    assert [info.name for info in await surface.connection.groups(f"{name}*")] == [name]


async def test_an_argument_that_differs_from_the_policy_of_the_group_is_refused(surface: Surface) -> None:
    left, right = await two_channels(surface)
    name = group_name()
    await surface.group(name, [left, right])
    assert (await surface.group(name, [left, right])).name == name
    with pytest.raises(st.GroupExists, match=name):
        await surface.group(name, [left, right], reference=right)


async def test_an_unknown_group_is_not_found(surface: Surface) -> None:
    with pytest.raises(st.GroupNotFound, match="contract/none"):
        await surface.group("contract/none")


async def test_members_are_added_and_removed(surface: Surface) -> None:
    left, right = await two_channels(surface)
    name = group_name()
    group = await surface.group(name, [left])
    await group.add(right)
    assert [channel.name for channel in (await surface.group(name)).channels] == [left.name, right.name]
    await group.remove(right)
    assert [channel.name for channel in group.channels] == [left.name]
    with pytest.raises(st.InvalidArgument, match="0 members"):
        await group.remove(left)


async def test_deleting_a_group_keeps_its_channels(surface: Surface) -> None:
    left, right = await two_channels(surface)
    group = await surface.group(group_name(), [left, right])
    await group.delete()
    with pytest.raises(st.GroupNotFound):
        await surface.group(group.name)
    await left.put(b"still here")


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"bound": "middle"}, "bound"),
        ({"reference": "contract/elsewhere"}, "not a member"),
        ({"idle_after": 5}, "idle_after"),
    ],
)
async def test_an_impossible_policy_of_a_group_is_refused_with_its_reason(
    surface: Surface, settings: dict[str, Any], expected: str
) -> None:
    left, right = await two_channels(surface)
    with pytest.raises(st.InvalidArgument, match=expected):
        await surface.group(group_name(), [left, right], **settings)


async def test_a_channel_cannot_be_in_a_group_twice(surface: Surface) -> None:
    left, _ = await two_channels(surface)
    with pytest.raises(st.InvalidArgument, match="twice"):
        await surface.group(group_name(), [left, left])


async def test_a_cross_section_holds_the_items_that_are_valid_at_the_references_item(surface: Surface) -> None:
    left, right = await two_channels(surface)
    base = st.now() - 10 * SECOND
    for number in range(3):
        await left.put(b"l%d" % number, time=base + number * SECOND)
    for number in range(12):
        await right.put(b"r%d" % number, time=base + number * 250 * MS)
    section = await surface.cross_section(left, [right], at=base + 1_100 * MS)
    assert section.time == base + SECOND
    assert [item.payload for item in section[left]] == [b"l1"]
    assert [item.payload for item in section[right]] == [b"r4"]


async def test_a_cross_section_over_a_span_has_all_items_whose_spans_overlap_it(surface: Surface) -> None:
    left, right = await two_channels(surface)
    base = st.now() - 10 * SECOND
    await left.put(b"first", time=base)
    await left.put(b"next", time=base + SECOND)
    for number in range(-1, 6):
        await right.put(b"%d" % number, time=base + number * 250 * MS + 100 * MS)
    section = await surface.cross_section(left, [right], at=base, over="span")
    assert [item.payload for item in section[right]] == [b"-1", b"0", b"1", b"2", b"3"]


async def test_a_complete_cross_section_waits_until_every_channel_has_passed(surface: Surface) -> None:
    left, right = await two_channels(surface)
    base = st.now() - 10 * SECOND
    await left.put(b"first", time=base)
    await right.put(b"before", time=base - SECOND)
    open_still = await surface.cross_section(left, [right], at=base, complete=True, timeout=0.05)
    assert not open_still[right].complete
    await right.put(b"at", time=base)
    await right.put(b"behind", time=base + 1)
    section = await surface.cross_section(left, [right], at=base, complete=True, timeout=10)
    assert section[right].complete
    assert [item.payload for item in section[right]] == [b"at"]


async def test_a_cross_section_of_an_empty_reference_gives_the_reason(surface: Surface) -> None:
    left, right = await two_channels(surface)
    section = await surface.cross_section(left, [right])
    assert section.time is None
    assert section[left].reason == "NOT_YET"
    assert right.name not in [channel.name for channel in section]


async def in_step(surface: Surface, **settings: Any) -> tuple[Any, Any, Any, int]:
    """Return two channels at two hosts, their group, and a time ten seconds ago."""
    left, right = await two_channels(surface)
    return await surface.group(group_name(), [left, right], **settings), left, right, st.now() - 10 * SECOND


async def test_a_group_shows_only_items_before_its_cut(surface: Surface) -> None:
    group, left, right, base = await in_step(surface)
    for number in range(4):
        await left.put(b"l%d" % number, time=base + number * SECOND)
    hidden = await group[left].get(base, st.NEWEST, timeout=0)
    assert (len(hidden), hidden.reason) == (0, "HIDDEN")
    assert right.name in hidden.reason.detail
    await right.put(b"r0", time=base)
    await right.put(b"r2", time=base + 2 * SECOND)
    shown = await group[left].get(base, base + 9 * SECOND, match="start", timeout=10)
    assert [item.payload for item in shown] == [b"l0", b"l1"]
    assert shown.cut == base + 2 * SECOND
    assert [item.payload for item in await left.get(base, st.NEWEST)] == [b"l0", b"l1", b"l2", b"l3"]


async def test_a_get_of_the_group_takes_one_cut_on_all_hosts(surface: Surface) -> None:
    group, left, right, base = await in_step(surface)
    for channel in (left, right):
        for number in range(3):
            await channel.put(b"%d" % number, time=base + number * SECOND)
    # Waits until the cut has reached this time.
    await group[left].get(base + SECOND, base + SECOND, match="start", timeout=10)
    await group[right].get(base + SECOND, base + SECOND, match="start", timeout=10)
    found = await group.get(base, base + 9 * SECOND, match="start")
    assert {items.cut for items in found.values()} == {base + 2 * SECOND}
    assert [[item.payload for item in found[channel.name]] for channel in (left, right)] == [[b"0", b"1"]] * 2
    newest = await group.newest()
    assert [newest[channel.name].payload for channel in (left, right)] == [b"1", b"1"]


async def test_the_newest_of_a_group_without_visible_items_gives_a_reason_for_each_member(surface: Surface) -> None:
    group, left, right, base = await in_step(surface)
    nothing = await group.newest()
    assert list(nothing.values()) == [None, None]
    assert [bool(nothing.reasons[channel.name].detail) for channel in (left, right)] == [True, True]
    await left.put(b"l0", time=base)
    await right.put(b"r0", time=base + 5)
    hidden = await group.newest()
    while "its cut is at" not in hidden.reasons[right.name].detail:  # until the hosts have told each other their cuts
        hidden = await group.newest()
    assert [hidden[channel.name] for channel in (left, right)] == [None, None]
    assert [hidden.reasons[channel.name] for channel in (left, right)] == ["HIDDEN", "HIDDEN"]
    assert f"held back by {left.name}" in hidden.reasons[right.name].detail
    await left.put(b"l1", time=base + 9)
    await group[left].get(base, base, match="start", timeout=10)
    shown = await group.newest()
    assert shown[left.name].payload == b"l0"
    assert [channel.name for channel in shown.reasons] == [right.name]


async def test_a_subscription_through_a_group_yields_items_in_the_order_in_which_they_become_visible(
    surface: Surface,
) -> None:
    group, left, right, base = await in_step(surface)
    async with group[left].subscribe() as items:
        for number in range(3):
            await left.put(b"%d" % number, time=base + number * SECOND)
        await right.put(b"r", time=base + 2 * SECOND)
        assert [item.payload for item in await take(items, 2)] == [b"0", b"1"]


async def test_cut_events_have_each_item_once_and_late_items_separately(surface: Surface) -> None:
    group, left, right, base = await in_step(surface)
    async with group.subscribe() as cuts:
        for number in range(3):
            await left.put(b"l%d" % number, time=base + number * SECOND)
        await right.put(b"r2", time=base + 2 * SECOND)
        first = await event_at(cuts, base + 2 * SECOND)
        assert first[left.name] == [b"l0", b"l1"]
        await left.put(b"late", time=base + SECOND // 2)
        await left.put(b"l4", time=base + 4 * SECOND)
        await right.put(b"r3", time=base + 3 * SECOND)
        second = await event_at(cuts, base + 3 * SECOND)
        assert second[left.name] == [b"l2"]
        assert second[right.name] == [b"r2"]
        assert second["late"] == [b"late"]


async def event_at(cuts: Any, time: int) -> dict[str, list[bytes]]:
    """Return all items of the events up to the cut at `time`, by channel; late items have the key "late"."""
    received: dict[str, list[bytes]] = {"late": []}
    while True:
        (cut,) = await take(cuts, 1)
        for channel in cut:
            received.setdefault(channel.name, []).extend(item.payload for item in cut[channel])
            received["late"] += [item.payload for item in cut.late[channel]]
        if cut.time >= time:
            return received


async def test_a_match_pairs_the_nearest_items_and_names_members_without_one(surface: Surface) -> None:
    group, left, right, base = await in_step(surface)
    async with group.match(left, "10ms", partial=True) as matches:
        await left.put(b"l0", time=base)
        await right.put(b"near", time=base + 4 * MS)
        await right.put(b"far", time=base + 30 * MS)
        await left.put(b"l1", time=base + 100 * MS)
        await right.put(b"r9", time=base + SECOND)
        pair, alone = await take(matches, 2)
    assert [pair[channel.name].payload for channel in (left, right)] == [b"l0", b"near"]
    assert alone[left.name].payload == b"l1"
    assert [channel.name for channel in alone.missing] == [right.name]
    assert matches.unmatched == 1


@pytest.mark.parametrize("per_is_left", [True, False])
async def test_a_match_with_a_start_begins_with_the_held_items_from_there_on(
    surface: Surface, per_is_left: bool
) -> None:
    left, right = (await two_channels(surface))[:: 1 if per_is_left else -1]
    group, base = await surface.group(group_name(), [left, right]), st.now() - 20 * SECOND
    for time in (0, 20, 40, 100):
        await left.put(b"l", time=base + time * MS)
        await right.put(b"r", time=base + (time + 1) * MS)
    for start, first in ((base + 20 * MS, 1), (st.OLDEST, 0), (st.OLDEST + "1ns", 1)):
        async with group.match(left, "5ms", start=start) as matches:
            pairs = [[item.time - base for item in one.values()] for one in await take(matches, 3 - first)]
            assert pairs == [[time * MS, (time + 1) * MS] for time in (0, 20, 40)[first:]]
            assert (matches.dropped, matches.losses) == (0, 0)
    with pytest.raises(st.InvalidArgument, match="start"):
        async with group.match(left, "5ms", start=1.5):
            pass


@pytest.mark.parametrize("per_is_left", [True, False])
async def test_a_unique_match_uses_each_item_once_even_after_a_broken_stream(
    surface: Surface, per_is_left: bool
) -> None:
    left, right = (await two_channels(surface))[:: 1 if per_is_left else -1]
    group, base = await surface.group(group_name(), [left, right]), st.now() - 20 * SECOND
    async with group.match(left, "10ms", unique=True, partial=True) as matches:
        for time in (10, 14, 40):
            await left.put(b"l", time=base + time * MS)
        for time in (5, 13, 60):
            await right.put(b"r", time=base + time * MS)
        pairs = [[item.time - base for item in one.values()] for one in await take(matches, 2)]
        assert pairs == [[10 * MS, 5 * MS], [14 * MS, 13 * MS]]
        matches._stream.cancel()
        await left.put(b"l", time=base + 100 * MS)
        (alone,) = await take(matches, 1)
        assert [channel.name for channel in alone.missing] == [right.name]
        matches._stream.cancel()
        await left.put(b"l", time=base + 55 * MS)
        await right.put(b"r", time=base + 200 * MS)
        await left.put(b"l", time=base + 200 * MS)
        (pair,) = await take(matches, 1)
        assert [item.time - base for item in pair.values()] == [55 * MS, 60 * MS]
        assert matches.dropped == 0


@pytest.mark.parametrize("per_is_left", [True, False])
async def test_items_that_arrive_late_by_at_most_the_lateness_are_matched(surface: Surface, per_is_left: bool) -> None:
    left, right = (await two_channels(surface))[:: 1 if per_is_left else -1]
    group, base = await surface.group(group_name(), [left, right]), st.now() - 20 * SECOND
    async with group.match(left, "5ms", lateness="100ms") as matches:
        for time in (0, 20, 80, 10, 300):
            await left.put(b"l", time=base + time * MS)
        for time in (4, 24, 90, 1, 9, 84, 300):
            await right.put(b"r", time=base + time * MS)
        pairs = [[item.time - base for item in one.values()] for one in await take(matches, 4)]
        assert pairs == [[0, MS], [10 * MS, 9 * MS], [20 * MS, 24 * MS], [80 * MS, 84 * MS]]
        assert matches.dropped == 0


async def test_a_negative_lateness_is_refused(surface: Surface) -> None:
    group, left, _, _ = await in_step(surface)
    with pytest.raises(st.InvalidArgument, match="lateness"):
        async with group.match(left, "5ms", lateness="-1s"):
            pass
    with pytest.raises(st.InvalidArgument, match="lateness"):
        async with group.subscribe(lateness="-1s"):
            pass


async def test_a_cut_event_waits_for_items_that_are_no_later_than_its_lateness(surface: Surface) -> None:
    group, left, right, base = await in_step(surface)
    async with group.subscribe("10s", lateness="100ms") as cuts:
        for channel, times in ((left, (0, 50, 20, 120)), (right, (0, 50, 30))):
            for time in times:
                await channel.put(b"%d" % time, time=base + time * MS)
        for time in (150, 300):
            for channel in (right, left):
                await channel.put(b"%d" % time, time=base + time * MS)
        received = await event_at(cuts, base + 50 * MS)
        assert received[left.name][:2] == [b"0", b"20"]
        assert received[right.name][:2] == [b"0", b"30"]
        assert received["late"] == []


async def test_the_status_names_the_member_that_holds_the_cut_back(surface: Surface) -> None:
    group, left, right, base = await in_step(surface)
    await left.put(b"l", time=base)
    waiting = await group.status()
    assert waiting.cut is None
    assert right.name in [channel.name for channel in waiting.waiting_on]
    await right.put(b"r", time=base + SECOND)
    await left.put(b"l", time=base + 2 * SECOND)
    await group[left].get(base, base, match="start", timeout=10)
    status = await group.status()
    assert status.cut == base + SECOND
    assert [channel.name for channel in status.waiting_on] == [right.name]
