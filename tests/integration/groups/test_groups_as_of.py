"""Groups as of an earlier instant: matches, changed members, archives that have dropped or lost items, rights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.cli.commands import run
from stampede_rt_local.cluster import LocalCluster
from tests.support.operator import operating
from tests.support.waiting import wait_until

MS = 10**6
FRAMES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("archive")


@pytest.fixture(scope="module")
def cluster(folder: Path) -> Iterator[LocalCluster]:
    """Two hosts with an archive each."""
    with LocalCluster(hosts=2, supernodes=1, archive=folder) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


class Rig:
    """Two recorded channels at different hosts, and their group."""

    def __init__(self, rt: st.Connection, name: str, **left: Any) -> None:
        hosts = sorted(one.name for one in rt.hosts())
        how = {"max_items": 3, "archive": "7d"}
        self.left = rt.channel(f"{name}/left", host=hosts[0], **{**how, **left})
        self.right = rt.channel(f"{name}/right", host=hosts[1], **how)
        self.group = rt.group(name, [self.left, self.right])
        self.began = self.now() - 60 * 10**9

    def now(self) -> int:
        return max(self.left.stats().host_time, self.right.stats().host_time)

    def put(self, number: int, size: int = 0) -> None:
        self.left.put(b"%d" % number + bytes(size), time=self.began + number * 10 * MS, ack="disk")
        self.right.put(b"%d" % number + bytes(size), time=self.began + number * 10 * MS + MS, ack="disk")


def shown(matches: Any, count: int | None = None) -> list[object]:
    """The next matches of an iterator; None: all."""
    found = []
    for one in matches:
        found.append((one.time, {channel.name: (item.payload, item.seq) for channel, item in one.items()}))
        found[-1] = (*found[-1], [channel.name for channel in one.missing])
        if len(found) == count:
            break
    return found


@pytest.mark.parametrize("unique", [False, True])
def test_matches_as_of_an_instant_equal_the_matches_that_a_subscription_got_then(
    rt: st.Connection, unique: bool
) -> None:
    rig = Rig(rt, f"matches-{unique}")
    how: dict[str, Any] = {"tolerance": "2ms", "unique": unique, "partial": True, "start": st.OLDEST}
    live = []
    for number in range(FRAMES):
        if number % 5 == 3:
            rig.left.put(b"alone", time=rig.began + number * 10 * MS - 5 * MS)
        rig.put(number)
        if number % 4 == 3:
            instant = rig.now()
            with rig.group.match(rig.left, **how) as matches:
                live.append((instant, shown(matches, number + (number + 2) // 5), matches.unmatched))
    rig.right.put(b"late", time=rig.began + ((FRAMES - 1) * 10 + 3) * MS)
    rig.put(FRAMES)
    rig.right.put(b"late, too", time=rig.began + ((FRAMES - 1) * 10 + 5) * MS)
    for instant, expected, unmatched in live:
        with rig.group.match(rig.left, as_of=instant, **how) as matches:
            found = shown(matches)
            assert (matches.dropped, matches.reason, matches.losses, matches.connected) == (0, None, 0, True)
        assert (found, matches.unmatched) == (expected, unmatched)
    with rig.group.match(rig.left, as_of=rig.began, **how) as matches:
        assert shown(matches) == []


async def test_the_asyncio_client_matches_as_of_an_instant(cluster: LocalCluster, rt: st.Connection) -> None:
    rig = Rig(rt, "aio")
    for number in range(4):
        rig.put(number)
    async with st.aio.connect(cluster.address, secret=cluster.secret.text) as aio:
        group = await aio.group("aio")
        async with group.match("aio/left", "2ms", start=rig.began + 10 * MS, as_of=rig.now()) as matches:
            found = [[item.payload for item in one.values()] async for one in matches]
    assert found == [[b"1", b"1"], [b"2", b"2"]]


def test_matches_as_of_an_instant_are_refused_if_archives_cannot_give_them(rt: st.Connection) -> None:
    rig = Rig(rt, "refusals")
    rig.put(0)
    with pytest.raises(st.InvalidArgument, match="give start"):
        rig.group.match(rig.left, "1ms", as_of=rig.now())
    idle = rt.group("refusals/idle", [rig.left, rig.right], reference=rig.left, idle_after="5s")
    with pytest.raises(st.InvalidArgument, match="idle_after"):
        idle.match(rig.left, "1ms", start=st.OLDEST, as_of=rig.now())
    live = rt.group("refusals/live", [rig.left, rt.channel("refusals/plain")])
    with pytest.raises(st.InvalidArgument, match="not recorded"):
        live.match(rig.left, "1ms", start=st.OLDEST, as_of=rig.now())
    with pytest.raises(st.InvalidArgument, match="ahead of the host"):
        rig.group.match(rig.left, "1ms", start=st.OLDEST, as_of=st.now() + 3600 * 10**9)


def test_a_past_cut_whose_items_the_archive_has_dropped_is_named_as_collected(rt: st.Connection) -> None:
    rig = Rig(rt, "dropped", archive="forever", archive_bytes="1MiB")
    instants = []
    for number in range(24):
        rig.put(number, 100_000)
        instants.append(rig.now())
    assert rig.left.oldest().payload[:2] != b"0\0"  # the archive has dropped the first items
    found = rig.group.get(st.OLDEST, st.NOW, as_of=instants[2])
    assert [(len(items), items.reason) for items in found.values()] == [(0, "COLLECTED")] * 2
    assert "dropped/left held back the earlier cut" in found[rig.right].reason.detail
    newest = rig.group.newest(as_of=instants[2])
    assert [newest[channel] for channel in newest] == [None, None]
    assert {channel.name: reason for channel, reason in newest.reasons.items()} == {
        "dropped/left": "COLLECTED",
        "dropped/right": "COLLECTED",
    }
    assert rig.group[rig.right].get(st.OLDEST, st.NOW, as_of=instants[2]).reason == "COLLECTED"
    with rig.group.match(rig.right, "2ms", start=st.OLDEST, as_of=instants[2]) as matches:
        assert shown(matches) == []
        assert matches.reason == "COLLECTED"
        assert "dropped/left" in matches.reason.detail
    later = rig.group.get(st.OLDEST, st.NOW, as_of=instants[-1])
    assert (len(later[rig.right]), later[rig.right].reason) == (23, None)  # the host knows this cut


def test_a_past_cut_whose_newest_item_is_damaged_is_named_as_lost(rt: st.Connection, folder: Path) -> None:
    rig = Rig(rt, "damaged")
    for number in range(6):
        rig.left.put(b"damaged-%d" % number + b"." * 2**18, time=rig.began + number * 10 * MS, ack="disk")
        rig.right.put(b"%d" % number, time=rig.began + number * 10 * MS + MS, ack="disk")
    path = next(one for one in folder.rglob("*.segment") if b"damaged-5" in one.read_bytes())
    instant, at = rig.now(), path.read_bytes().index(b"damaged-5")
    with path.open("r+b") as file:
        file.seek(at)
        file.write(b"D")
    right = rig.group[rig.right].get(st.OLDEST, st.NOW, as_of=instant)
    assert ([item.payload for item in right], right.reason) == ([b"%d" % number for number in range(4)], "LOST")
    assert "damaged/left held back the earlier cut" in right.reason.detail
    found = rig.group.newest(as_of=instant)
    assert (found[rig.right].payload, found.reasons[rig.right]) == (b"3", "LOST")
    whole = rig.group[rig.right].get(rig.began, rig.began + 20 * MS, as_of=instant)
    assert (len(whole), whole.reason) == (2, None)  # the whole interval lies before the cut
    with rig.group.match(rig.right, "2ms", start=st.OLDEST, as_of=instant) as matches:
        assert len(shown(matches)) == 4
        assert matches.reason == "LOST"


def test_a_group_that_others_have_changed_is_read_with_its_present_members(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    rig = Rig(rt, "changed")
    for number in range(3):
        rig.put(number)
    rig.right.put(b"ahead", time=rig.began + 1000 * MS, ack="disk")
    third = rt.channel("changed/third", max_items=3, archive="7d")
    third.put(b"far behind", time=rig.began + 5 * MS, ack="disk")
    instant = max(rig.now(), third.stats().host_time)
    assert rig.group[rig.right].newest(as_of=instant).payload == b"1"
    with st.connect(cluster.address, secret=cluster.secret.text) as other:
        other.group("changed").add(other.channel("changed/third", create=False))
        other.group("changed").get(st.OLDEST, st.NOW)  # the hosts of the group know the member now
        assert rig.group[rig.right].newest(as_of=instant).payload == b"0"
        assert [channel.name for channel in rig.group.newest(as_of=instant)][-1] == "changed/third"
        with rig.group.match(rig.left, "2ms", start=st.OLDEST, as_of=instant, partial=True) as matches:
            assert [one[2] for one in shown(matches)] == [["changed/third"]]


def test_a_past_cut_needs_the_right_to_read_all_members_that_decide_it(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    rig = Rig(rt, "rights")
    for number in range(3):
        rig.put(number)
    led = rt.group("rights/led", [rig.left, rig.right], reference=rig.right)
    instant = rig.now()
    with operating(cluster) as operator:
        for verb, name, kind in (("read", "rights/right", "channel"), ("read", "rights*", "group")):
            operator.add("reader", verb, name, "--kind", kind)
        with st.connect(cluster.address, secret=operator.token("reader")) as reader:
            group = reader.group("rights")
            wait_until(lambda: group["rights/right"].newest() is not None)
            with pytest.raises(st.PermissionDenied, match="right to read its channel 'rights/left'"):
                group["rights/right"].newest(as_of=instant)
            with pytest.raises(st.PermissionDenied, match="rights/left"):
                group.match("rights/right", "1ms", start=st.OLDEST, as_of=instant)
            assert reader.group(led.name)["rights/right"].newest(as_of=instant).payload == b"1"


def test_the_verbs_of_groups_answer_as_of_an_instant(
    cluster: LocalCluster, rt: st.Connection, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(rt, "verbs")
    for number in range(3):
        rig.put(number)
    instant = rig.now()
    rig.put(3)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    as_of = ("--as-of", str(instant))
    assert run(["group", "newest", "verbs", *as_of]) == 0
    assert capsys.readouterr().out.count(" 1\n") == 2
    assert run(["group", "get", "verbs", "oldest", "now", *as_of]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 4
    match = ["group", "match", "verbs", "--per", "verbs/left", "--tolerance", "2ms"]
    assert run([*match, "--from", "oldest", *as_of]) == 0
    assert capsys.readouterr().out.count("match ") == 2
    assert run([*match, *as_of]) != 0
    assert "give start" in capsys.readouterr().err
