"""Groups and cross-sections on real hosts, by both clients: what one process sets up, every other finds."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.contract.surfaces import Surface
from tests.support.cluster import cluster_fixture

MS = 1_000_000
SECOND = 1_000 * MS

grouped_cluster = cluster_fixture(hosts=2, supernodes=1)
_names = itertools.count()


@pytest.fixture(params=["aio", "sync"])
async def surface(request: pytest.FixtureRequest, grouped_cluster: LocalCluster) -> AsyncIterator[Surface]:
    if request.param == "aio":
        async with aio.connect(grouped_cluster.address) as connection:
            yield Surface(connection)
        return
    with st.connect(grouped_cluster.address) as blocking, ThreadPoolExecutor(16) as pool:
        yield Surface(blocking, pool)


async def two_channels(surface: Surface, **policy: Any) -> tuple[Any, Any]:
    """One at each host."""
    hosts = await surface.connection.hosts()
    left, right = [await surface.channel(host=host.name, **({"max_age": "60s"} | policy)) for host in hosts]
    return left, right


def group_name() -> str:
    return f"contract/{next(_names)}-{st.now()}"


async def test_a_group_is_found_by_its_name_with_its_set_up(surface: Surface) -> None:
    left, right = await two_channels(surface)
    name = group_name()
    made = await surface.group(name, [left, right], reference=left, bound="end", idle_after="2s", max_lead="1s")
    found = await surface.group(name)
    assert found.info == made.info
    assert [channel.name for channel in found.channels] == [left.name, right.name]
    assert (found.info.bound, found.info.idle_after_nanos, found.info.max_lead_nanos) == ("end", 2 * SECOND, SECOND)
    assert found.info.reference_id == left.info.channel_id
    assert [info.name for info in await surface.connection.groups(f"{name}*")] == [name]


async def test_a_group_that_is_set_up_otherwise_is_refused(surface: Surface) -> None:
    left, right = await two_channels(surface)
    name = group_name()
    await surface.group(name, [left, right])
    assert (await surface.group(name, [left, right])).name == name
    with pytest.raises(st.GroupExists, match=name):
        await surface.group(name, [left, right], reference=right)


async def test_a_group_that_nobody_made_is_not_found(surface: Surface) -> None:
    with pytest.raises(st.GroupNotFound, match="contract/none"):
        await surface.group("contract/none")


async def test_members_come_and_go(surface: Surface) -> None:
    left, right = await two_channels(surface)
    name = group_name()
    group = await surface.group(name, [left])
    await group.add(right)
    assert [channel.name for channel in (await surface.group(name)).channels] == [left.name, right.name]
    await group.remove(right)
    assert [channel.name for channel in group.channels] == [left.name]
    with pytest.raises(st.InvalidArgument, match="0 members"):
        await group.remove(left)


async def test_a_deleted_group_is_gone_and_its_channels_stay(surface: Surface) -> None:
    left, right = await two_channels(surface)
    group = await surface.group(group_name(), [left, right])
    await group.delete()
    with pytest.raises(st.GroupNotFound):
        await surface.group(group.name)
    await left.put(b"still here")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"bound": "middle"}, "bound"),
        ({"reference": "contract/elsewhere"}, "no member"),
        ({"idle_after": 5}, "idle_after"),
    ],
)
async def test_a_set_up_that_cannot_be_is_refused_and_named(
    surface: Surface, settings: dict[str, Any], said: str
) -> None:
    left, right = await two_channels(surface)
    with pytest.raises(st.InvalidArgument, match=said):
        await surface.group(group_name(), [left, right], **settings)


async def test_a_channel_is_in_a_group_once(surface: Surface) -> None:
    left, _ = await two_channels(surface)
    with pytest.raises(st.InvalidArgument, match="twice"):
        await surface.group(group_name(), [left, left])


async def test_a_cross_section_gives_what_holds_at_the_references_item(surface: Surface) -> None:
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


async def test_a_cross_section_over_the_span_gives_all_that_share_an_instant_with_it(surface: Surface) -> None:
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


async def test_a_cross_section_of_an_empty_reference_says_why(surface: Surface) -> None:
    left, right = await two_channels(surface)
    section = await surface.cross_section(left, [right])
    assert section.time is None
    assert section[left].reason == "NOT_YET"
    assert right.name not in [channel.name for channel in section]
