"""Groups that other processes change during reads, with both clients."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.contract.surfaces import Surface, connected, take

MS = 1_000_000
SECOND = 1_000 * MS

_names = itertools.count()


@pytest.fixture(params=["aio", "sync"])
async def surface(request: pytest.FixtureRequest, grouped_cluster: LocalCluster) -> AsyncIterator[Surface]:
    async with connected(request.param, grouped_cluster.address) as surface:
        yield surface


@pytest.fixture
async def other(grouped_cluster: LocalCluster) -> AsyncIterator[aio.Connection]:
    """Yield another connection, which looks like another process to the cluster."""
    async with aio.connect(grouped_cluster.address) as connection:
        yield connection


async def channel_at_each_host(surface: Surface) -> list[Any]:
    return [await surface.channel(host=host.name, max_age="120s") for host in await surface.connection.hosts()]


def group_name() -> str:
    return f"changing/{next(_names)}-{st.now()}"


async def put_all(channels: list[Any], time: int) -> None:
    for channel in channels:
        await channel.put(channel.name.encode(), time=time)


async def test_cut_events_have_the_items_of_members_that_another_client_has_added(
    surface: Surface, other: aio.Connection
) -> None:
    left, right = await channel_at_each_host(surface)
    group, base = await surface.group(group_name(), [left]), st.now() - 20 * SECOND
    async with group.subscribe() as cuts:
        await (await other.group(group.name)).add(await other.channel(right.name))
        received = []
        for step in itertools.count():  # ends with the test's time limit
            await put_all([left, right], base + step * SECOND // 100)
            cut = (await take(cuts, 1))[0] if step else None
            if cut is not None and right.name in [channel.name for channel in cut]:
                received += [item.payload for item in cut[right.name]]
            if received:
                break
    assert received[0] == right.name.encode()


async def test_cut_events_have_the_items_of_a_member_that_another_process_has_moved(
    surface: Surface, other: aio.Connection
) -> None:
    member, base = (await channel_at_each_host(surface))[0], st.now() - 20 * SECOND
    group, theirs = await surface.group(group_name(), [member]), await other.channel(member.name)
    await member.put(b"0", time=base)  # from now on this client knows the first host
    async with theirs.subscribe() as witness:
        await other.move(member.name, (await surface.connection.hosts())[-1].name)
        await theirs.put(b"1", time=base + SECOND)
        await anext(witness)  # comes from the new host: the first one has ended its streams of this channel
    received = []
    async with group.subscribe() as cuts:
        await theirs.put(b"2", time=base + 2 * SECOND)
        while True:  # ends with the cut at the last item
            (cut,) = await take(cuts, 1)
            received += [item.payload for item in cut[member.name]]
            if cut.time >= base + 2 * SECOND:
                break
    assert received in ([b"1"], [b"0", b"1"])  # a host that has just met the group may begin at an earlier cut


async def test_matches_follow_members_that_another_client_adds_and_removes(
    surface: Surface, other: aio.Connection
) -> None:
    left, right = await channel_at_each_host(surface)
    third = await surface.channel(max_age="120s")
    group, base = await surface.group(group_name(), [left, right]), st.now() - 20 * SECOND
    theirs = await other.group(group.name)
    async with group.match(left, "1ms", partial=True) as matches:
        await theirs.add(await other.channel(third.name))
        await theirs.remove(await other.channel(right.name))
        for step in range(1, 1_000):
            await put_all([left, right, third], base + step * SECOND // 100)
            await put_all([right, third], base + step * SECOND // 100 + 2 * MS)
            (matched,) = await take(matches, 1)
            if [channel.name for channel in matched] == [left.name, third.name]:
                break
    assert {item.payload for item in matched.values()} == {left.name.encode(), third.name.encode()}
    assert not matched.missing


async def test_a_read_of_a_group_uses_its_present_members(surface: Surface, other: aio.Connection) -> None:
    left, right = await channel_at_each_host(surface)
    group, base = await surface.group(group_name(), [left, right]), st.now() - 20 * SECOND
    await left.put(b"0", time=base)
    assert (await group.newest())[left.name] is None
    await (await other.group(group.name)).remove(await other.channel(right.name))
    await left.put(b"1", time=base + SECOND)
    await group[left].get(base, base, match="start", timeout=10)
    found = await group.newest()
    assert [(channel.name, item.payload) for channel, item in found.items()] == [(left.name, b"0")]
    assert [channel.name for channel in (await group.status()).members] == [left.name]


async def test_a_group_whose_member_was_deleted_is_read_without_it(surface: Surface, other: aio.Connection) -> None:
    left, right = await channel_at_each_host(surface)
    group, base = await surface.group(group_name(), [left, right]), st.now() - 20 * SECOND
    await put_all([left, right], base)
    await group.status()
    await (await other.channel(left.name)).delete()
    await right.put(b"1", time=base + SECOND)
    assert [channel.name for channel in await group.get(base, base + SECOND)] == [right.name]
    assert [channel.name for channel in (await group.status()).members] == [right.name]


async def test_a_descriptor_made_from_a_handle_decodes_as_the_handle_does(surface: Surface) -> None:
    left, _ = await channel_at_each_host(surface)
    name, base = group_name(), st.now() - 20 * SECOND
    await surface.group(name, [left])
    coded = await surface.channel(left.name, codec="json")
    await coded.put({"x": 1}, time=base)
    await coded.put({"x": 2}, time=base + 1)
    group = await surface.group(name)
    assert (await group[coded].newest(timeout=10)).value == {"x": 1}


async def test_a_match_counts_partners_that_retention_removed_before_the_client_fetched_them(surface: Surface) -> None:
    left, _ = await channel_at_each_host(surface)
    hosts = [host.name for host in await surface.connection.hosts()]
    right = await surface.channel(host=hosts[-1], max_items=1)
    group, base = await surface.group(group_name(), [left, right]), st.now() - 20 * SECOND
    async with group.match(left, "1ms", partial=True) as matches:
        await right.put(b"gone", time=base)
        await left.put(b"alone", time=base)
        await right.put(b"held", time=base + SECOND)
        await left.put(b"matched", time=base + SECOND)
        await right.advance(base + 2 * SECOND)
        alone, matched = await take(matches, 2)
        assert (len(alone), len(matched)) == (1, 2)
        assert matches.unmatched + matches.dropped == 1


async def test_a_group_made_of_descriptors_has_their_channels(surface: Surface) -> None:
    left, right = await channel_at_each_host(surface)
    base = st.now() - 20 * SECOND
    first = await surface.group(group_name(), [left, right])  # shows nothing: the right channel is empty
    second = await surface.group(group_name(), [first[left]])
    await left.put(b"0", time=base)
    await left.put(b"1", time=base + SECOND)
    assert (await second[left].newest(timeout=10)).payload == b"0"
    newest = await second.newest()
    assert newest[left.name].payload == b"0"


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        (lambda group, left: group.add("a name"), "'a name' is not a channel"),
        (lambda group, left: group.remove(None), "None is not a channel"),
        (lambda group, left: anext(aiter(group.match(None, "1ms"))), "None is not a member of the group"),
        (lambda group, left: anext(aiter(group.match(left, "-1ms"))), "tolerance is '-1ms'"),
        (lambda group, left: anext(aiter(group.subscribe("-1s"))), "max_wait is '-1s'"),
    ],
)
async def test_a_channel_that_cannot_be_a_member_is_refused_and_named(
    other: aio.Connection, call: Any, expected: str
) -> None:
    left = await other.channel(f"changing/{next(_names)}-{st.now()}")
    group = await other.group(group_name(), [left])
    with pytest.raises(st.InvalidArgument, match=expected):
        await call(group, left)


async def test_a_cross_section_accepts_only_channels_and_the_error_says_so(surface: Surface) -> None:
    left, right = await channel_at_each_host(surface)
    for others, expected in ((right, "give a list"), (["a name"], "'a name' is not a channel")):
        with pytest.raises(st.InvalidArgument, match=expected):
            await surface.cross_section(left, others)


async def test_reads_of_a_group_have_no_gap_and_no_duplicate_after_broken_streams(other: aio.Connection) -> None:
    left, right = [
        await other.channel(f"changing/{next(_names)}-{st.now()}", host=host.name, max_age="120s")
        for host in await other.hosts()
    ]
    group, base = await other.group(group_name(), [left, right]), st.now() - 20 * SECOND
    for step in (0, 1):
        await put_all([left, right], base + step * SECOND)
    assert await group[left].newest(timeout=10) is not None
    async with group[left].subscribe() as items, group.subscribe() as cuts, group.match(left, "1ms") as matches:
        times: dict[str, list[int]] = {"items": [], "cuts": [], "matches": []}
        for step in (2, 3, 4, 5):
            for stream in (items._stream, matches._stream, *(one.conversation for one in cuts._streams)):
                assert stream is not None
                stream._call.cancel()
            await put_all([left, right], base + step * SECOND)
            times["items"] += [item.time for item in await take(items, 1)]
            times["cuts"] += [item.time for cut in await take(cuts, 1) for item in cut[left]]
            if step > 2:  # the item before, whose time the other channel has passed now
                times["matches"] += [matched.time for matched in await take(matches, 1)]
    assert times["items"] == times["cuts"] == [base + step * SECOND for step in (1, 2, 3, 4)]
    assert times["matches"] == [base + step * SECOND for step in (2, 3, 4)]


async def test_late_items_are_counted_while_a_stream_of_matches_is_broken(other: aio.Connection) -> None:
    left, right = [
        await other.channel(f"changing/{next(_names)}-{st.now()}", host=host.name, max_age="120s")
        for host in await other.hosts()
    ]
    group, base = await other.group(group_name(), [left, right]), st.now() - 20 * SECOND
    async with group.match(left, "1ms") as matches:
        for step in (2, 3):
            await put_all([left, right], base + step * SECOND)
        assert [matched.time for matched in await take(matches, 1)] == [base + 2 * SECOND]
        assert matches._stream is not None
        matches._stream._call.cancel()
        await left.put(b"late", time=base + SECOND)
        for step in (4, 5):
            await put_all([left, right], base + step * SECOND)
        assert [matched.time for matched in await take(matches, 2)] == [base + 3 * SECOND, base + 4 * SECOND]
        assert matches.dropped == 1
