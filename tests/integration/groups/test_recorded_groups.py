"""Groups of recorded channels: reads through a group, and cross-sections, go on in the archive."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import pytest
from PIL import Image

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.waiting import wait_until

DOCS = Path(__file__).resolve().parents[3] / "docs"

ITEMS = 300
MS = 10**6


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    """Two hosts with an archive each."""
    with LocalCluster(hosts=2, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


class Rig:
    """Two recorded channels, at different hosts, whose memory holds their last items, and a group of both."""

    def __init__(self, rt: st.Connection, name: str, ahead: int = 0) -> None:
        """The second channel is behind the first one by `ahead` items."""
        hosts = sorted(one.name for one in rt.hosts())
        self.connection = rt
        self.camera = rt.channel(f"{name}/camera", max_items=5, archive="forever", host=hosts[0])
        self.imu = rt.channel(f"{name}/imu", max_items=5, archive="forever", host=hosts[1])
        self.began = self.camera.stats().host_time - 60 * 10**9
        self.put(self.camera, 0, ITEMS)
        self.put(self.imu, 0, ITEMS - ahead)
        for channel in (self.camera, self.imu):
            wait_until(lambda channel=channel: channel.stats().held <= 5)
        self.group = rt.group(name, [self.camera, self.imu])
        self.cut = self.began + (ITEMS - ahead - 1) * MS
        wait_until(lambda: self.group.status().cut == self.cut)

    def put(self, channel: st.Channel, first: int, end: int) -> None:
        with channel.producer() as producer:
            for number in range(first, end):
                producer.put(b"%d" % number, time=self.began + number * MS)


def numbers(items: st.Items) -> list[int]:
    return [int(item.payload) for item in items]


def test_reads_through_a_group_continue_in_the_archives_of_several_hosts(rt: st.Connection) -> None:
    rig = Rig(rt, "through")
    found = rig.group.get(rig.began, st.NOW)
    assert {channel.name: numbers(items) for channel, items in found.items()} == {
        "through/camera": list(range(ITEMS - 1)),
        "through/imu": list(range(ITEMS - 1)),
    }
    assert {items.cut for items in found.values()} == {rig.cut}
    shown = rig.group[rig.imu]
    assert numbers(shown.at(rig.began + 7 * MS + 5)) == [7]
    oldest, before, newest = shown.oldest(), shown.before(rig.began + 5 * MS), shown.newest()
    assert [one and one.payload for one in (oldest, before, newest)] == [b"0", b"4", b"%d" % (ITEMS - 2)]
    memory = shown.get(rig.began, rig.began + 3 * MS, within="memory")
    assert (len(memory), memory.reason) == (0, "COLLECTED")
    assert shown.get(rig.began - 5 * MS, rig.began - MS).reason == "NEVER"
    backwards = shown.get(st.OLDEST, st.NOW, newest_first=True, limit=20)
    assert numbers(backwards) == list(range(ITEMS - 2, ITEMS - 22, -1))
    assert numbers(shown.get(st.OLDEST, st.NOW, after=backwards[-1], newest_first=True, limit=2)) == [278, 277]


def test_a_group_far_behind_shows_archived_items_before_its_cut_and_names_the_hidden_ones(
    rt: st.Connection,
) -> None:
    rig = Rig(rt, "behind", ahead=200)
    shown = rig.group[rig.camera]  # memory has none of its visible items
    newest = shown.newest()
    assert newest is not None
    assert newest.payload == b"98"
    assert newest.end is None  # the next item is hidden, and ends no span yet
    part = shown.get(rig.began + 90 * MS, rig.began + 110 * MS)
    assert (numbers(part), part.reason) == (list(range(90, 99)), "HIDDEN")
    hidden = shown.get(rig.began + 150 * MS, rig.began + 160 * MS)
    assert (numbers(hidden), hidden.reason) == ([], "HIDDEN")


def test_a_get_that_waits_for_hidden_archived_items_returns_when_the_cut_shows_them(rt: st.Connection) -> None:
    rig = Rig(rt, "waiting", ahead=200)
    shown, got = rig.group[rig.camera], []

    def wait(complete: bool) -> None:
        items = shown.get(rig.began + 150 * MS, rig.began + 160 * MS, timeout=40, complete=complete)
        got.append((complete, numbers(items)))

    waiting = [threading.Thread(target=wait, args=(complete,)) for complete in (False, True)]
    for thread in waiting:
        thread.start()
    rig.put(rig.imu, ITEMS - 200, 152)
    wait_until(lambda: got)
    assert got == [(False, [150])]
    rig.put(rig.imu, 152, 162)
    for thread in waiting:
        thread.join(40)
    assert got[1:] == [(True, list(range(150, 161)))]


def test_all_pages_of_a_long_read_through_a_group_use_one_cut(rt: st.Connection) -> None:
    large = rt.channel("pages/large", max_items=2, archive="forever")
    began = large.stats().host_time - 60 * 10**9
    for number in range(10):
        large.put(b"%d" % number + bytes(2**20), time=began + number * MS)
    wait_until(lambda: large.stats().held <= 2)
    group = rt.group("pages", [large])
    items = group[large].get(began, st.NOW)
    assert [item.payload[:1] for item in items] == [b"%d" % number for number in range(9)]
    assert items.cut == began + 9 * MS


def test_a_subscription_through_a_group_begins_in_the_archive_and_continues_with_live_items(rt: st.Connection) -> None:
    rig = Rig(rt, "subscribed")
    with rig.group[rig.camera].subscribe(start=rig.began + 20 * MS) as items:
        assert [int(next(items).payload) for _ in range(100)] == list(range(20, 120))
        for channel in (rig.camera, rig.imu):
            rig.put(channel, ITEMS, ITEMS + 100)  # memory loses items that the reader has not taken yet
        assert [int(next(items).payload) for _ in range(ITEMS - 21)] == list(range(120, ITEMS + 99))
        assert items.dropped == 0
    with rig.group[rig.camera].subscribe(start=st.OLDEST) as items:
        assert [int(next(items).payload) for _ in range(3)] == [0, 1, 2]


def test_a_cross_section_of_the_past_is_read_from_the_archives(rt: st.Connection) -> None:
    rig = Rig(rt, "section")
    for camera, imu in ((rig.camera, rig.imu), (rig.group[rig.camera], rig.group[rig.imu])):
        found = rt.cross_section(camera, [imu], at=rig.began + 7 * MS + 5, over="span")
        assert (numbers(found.items[camera]), numbers(found.items[imu])) == ([7], [7])


def test_the_picture_of_one_read_is_drawn_from_a_recorded_channel(rt: st.Connection, tmp_path: Path) -> None:
    from tools import (  # not at the top: every worker of the suite would load matplotlib
        recording_picture,
        time_pictures,
    )

    page = (DOCS / "recording.md").read_text()
    assert f"images/{recording_picture.NAME}" in page
    time_pictures.draw(recording_picture.one_read(rt), tmp_path / "fresh.png")
    with Image.open(tmp_path / "fresh.png") as fresh, Image.open(DOCS / "images" / recording_picture.NAME) as committed:
        assert fresh.size == committed.size


def beside(matched: st.Matched[st.Channel]) -> list[int]:
    return [int(item.payload) for item in matched.values()]


@pytest.mark.parametrize("unique", [True, False])
def test_matches_begin_in_the_archives_of_several_hosts_and_continue_with_live_items(
    rt: st.Connection, unique: bool
) -> None:
    rig = Rig(rt, f"matched-{unique}")
    beside_camera = rt.channel(f"matched-{unique}/near", max_items=5, archive="forever", host=rig.camera.host)
    rig.put(beside_camera, 0, ITEMS)
    rig.group.add(beside_camera)
    with rig.group.match(rig.camera, "200us", unique=unique, start=rig.began + 7 * MS) as matches:
        found = [beside(one) for one in islice(matches, ITEMS - 8)]
        for channel in (rig.camera, rig.imu, beside_camera):
            rig.put(channel, ITEMS, ITEMS + 3)
        found += [beside(one) for one in islice(matches, 3)]
        assert (matches.unmatched, matches.dropped) == (0, 0)
    assert found == [[number] * 3 for number in range(7, ITEMS + 2)]


def test_a_reader_of_matches_that_is_slower_than_the_collection_misses_no_match(rt: st.Connection) -> None:
    rig = Rig(rt, "slow-matches")
    with rig.group.match(rig.camera, "200us") as matches:
        matches._stream.cancel()  # a break: meanwhile memory loses all new items except the last ones
        for channel in (rig.camera, rig.imu):
            rig.put(channel, ITEMS, 2 * ITEMS)
            wait_until(lambda channel=channel: channel.stats().held <= 5)
        assert [beside(one) for one in islice(matches, ITEMS - 1)] == [[n] * 2 for n in range(ITEMS, 2 * ITEMS - 1)]
        assert matches.dropped == 0


async def test_the_asyncio_client_gets_matches_of_large_items_from_the_archive(cluster: LocalCluster) -> None:
    async with st.aio.connect(cluster.address, secret=cluster.secret.text) as rt:
        left, right = [await rt.channel(f"large/{side}", max_items=2, archive="forever") for side in "lr"]
        began = (await left.stats()).host_time - 60 * 10**9
        for number in range(12):
            for channel in (left, right):
                await channel.put(bytes([number]) * 2**20, time=began + number * MS)
        group = await rt.group("large", [left, right])
        async with group.match(right, "0s", start=st.OLDEST) as matches:
            async for one in matches:
                number = one[left].payload[0]
                assert [item.payload == bytes([number]) * 2**20 for item in one.values()] == [True, True]
                if number == 10:
                    break


def as_read(rig: Rig, as_of: int | None) -> list[object]:
    """The answers to reads of every kind through a group."""
    camera, place = rig.group[rig.camera], rig.began + (ITEMS - 5) * MS
    found = rig.group.get(place, rig.began + 2 * ITEMS * MS, as_of=as_of)
    newest = rig.group.newest(as_of=as_of)
    part, at = camera.get(place, st.NOW, as_of=as_of), camera.at(place, as_of=as_of)
    before, oldest = camera.before(st.NOW, as_of=as_of), camera.oldest(as_of=as_of)
    section = rig.connection.cross_section(camera, [rig.group[rig.imu]], place + 5, as_of=as_of)
    answers = [*found.values(), part, at, *section.items.values()]
    facts = [([(one.payload, one.end, one.seq) for one in items], items.reason, items.cut) for items in answers]
    singles = [newest[rig.camera], newest[rig.imu], camera.newest(as_of=as_of), before, oldest]
    return [*facts, *((one and (one.payload, one.end)) for one in singles), section.time]


def test_reads_through_a_group_as_of_an_instant_equal_the_reads_at_that_instant(rt: st.Connection) -> None:
    rig = Rig(rt, "past", ahead=3)
    live = []
    for number in range(ITEMS - 3, ITEMS + 3):
        live.append((rig.imu.stats().host_time, rig.cut, as_read(rig, None)))
        rig.put(rig.imu, number, number + 1)
        rig.cut = rig.began + min(number, ITEMS - 1) * MS
        wait_until(lambda: rig.group.status().cut == rig.cut)
    rig.imu.advance(rig.began + ITEMS * 9 * MS)
    rig.put(rig.camera, 2 * ITEMS, 2 * ITEMS + 2)
    for as_of, cut, answers in live:
        assert as_read(rig, as_of) == answers
        assert rig.group.get(st.OLDEST, st.NOW, as_of=as_of)[rig.imu].cut == cut
    before = rig.group.get(st.OLDEST, st.NOW, as_of=rig.began)
    assert [(len(items), items.reason) for items in before.values()] == [(0, "NOT_YET")] * 2
    assert rig.group.status().cut == rig.group.get(st.OLDEST, st.NOW)[rig.imu].cut  # the present cut stays


def test_a_group_refuses_reads_as_of_an_instant_if_archives_cannot_give_its_past_cuts(rt: st.Connection) -> None:
    rig = Rig(rt, "refused")
    live = rt.channel("refused/live")
    kinds = {"idle_after": {"idle_after": "5s"}, "bound": {"bound": "end"}}
    for reason, how in kinds.items():
        group = rt.group(f"refused/{reason}", [rig.camera, rig.imu], **how)
        with pytest.raises(st.InvalidArgument, match=reason):
            group.newest(as_of=rig.began)
    with pytest.raises(st.InvalidArgument, match="not recorded"):
        rt.group("refused/member", [rig.camera, live]).newest(as_of=rig.began)
    led = rt.group("refused/not", [rig.camera, live], reference=rig.camera, idle_after="5s")
    assert led[rig.camera].newest(as_of=rig.camera.stats().host_time).payload == b"%d" % (ITEMS - 2)
    with pytest.raises(st.InvalidArgument, match="as_of"):
        led[rig.camera].newest(as_of=rig.began, timeout=1)
    with pytest.raises(st.InvalidArgument, match="ahead of the host"):
        rig.group.newest(as_of=st.now() + 3600 * 10**9)
