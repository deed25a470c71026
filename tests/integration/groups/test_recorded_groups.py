"""Groups of recorded channels: reads through a group, and cross-sections, go on in the archive."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from PIL import Image

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.waiting import wait_until
from tools import recording_picture
from tools.time_pictures import draw

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


def test_reads_through_a_group_go_on_in_the_archives_of_several_hosts(rt: st.Connection) -> None:
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
    assert newest.end is None  # the hidden item after it ends no span yet
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


def test_a_long_read_through_a_group_comes_in_pages_of_one_cut(rt: st.Connection) -> None:
    large = rt.channel("pages/large", max_items=2, archive="forever")
    began = large.stats().host_time - 60 * 10**9
    for number in range(10):
        large.put(b"%d" % number + bytes(2**20), time=began + number * MS)
    wait_until(lambda: large.stats().held <= 2)
    group = rt.group("pages", [large])
    items = group[large].get(began, st.NOW)
    assert [item.payload[:1] for item in items] == [b"%d" % number for number in range(9)]
    assert items.cut == began + 9 * MS


def test_a_subscription_through_a_group_begins_in_the_archive_and_goes_on_live(rt: st.Connection) -> None:
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


def test_a_read_through_a_group_as_of_an_earlier_instant_is_refused(rt: st.Connection) -> None:
    rig = Rig(rt, "as-of")
    with pytest.raises(st.InvalidArgument, match="through a group"):
        rig.group[rig.imu].get(st.OLDEST, st.NOW, as_of=rig.imu.stats().host_time)


def test_the_picture_of_one_read_is_drawn_from_a_recorded_channel(rt: st.Connection, tmp_path: Path) -> None:
    page = (DOCS / "recording.md").read_text()
    assert f"images/{recording_picture.NAME}" in page
    draw(recording_picture.one_read(rt), tmp_path / "fresh.png")
    with Image.open(tmp_path / "fresh.png") as fresh, Image.open(DOCS / "images" / recording_picture.NAME) as committed:
        assert fresh.size == committed.size
