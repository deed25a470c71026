"""The process of `stampede web` with a real cluster: its answers to the page's requests."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlencode
from urllib.request import HTTPCookieProcessor, HTTPSHandler, Request, build_opener, urlopen

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.identity import Role
from stampede_rt_web import following
from stampede_rt_web.app import main
from stampede_rt_web.drawing import Window
from stampede_rt_web.png import png_of
from tests.support.cluster import running_cluster
from tests.support.live_page import ANSWER_SECONDS, LivePage, eventually, live_page

np = pytest.importorskip("numpy")

SECOND = 1_000_000_000
MS = 1_000_000


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    with running_cluster(hosts=1, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        yield running


@pytest.fixture(scope="module")
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


@pytest.fixture(scope="module")
def page(cluster: LocalCluster) -> Iterator[LivePage]:
    with live_page(cluster.address) as running:
        yield running


def drawing(page: LivePage, name: str, around: int) -> dict[str, Any]:
    window = {"from": around - 20 * SECOND, "to": around + 20 * SECOND, "width": 1000}
    status, answer = page.ask("timeline", channel=name, **window)
    assert status == 200
    assert answer["base"] == str(around - 20 * SECOND)
    found: dict[str, Any] = answer["channels"][name]
    return found


def test_the_overview_has_the_counters_of_channels_and_the_parts_of_the_cluster(
    rt: st.Connection, page: LivePage
) -> None:
    channel = rt.channel("overview/a", max_age="1m")
    channel.put(b"12345")
    rt.group("overview/group", [channel])
    rt.queue("overview/queue").put(b"message")

    def complete() -> dict[str, Any] | None:
        _, answer = page.ask("overview")
        rows = {row["name"]: row for row in answer["channels"]}
        found = rows.get("overview/a", {}).get("held") == 1 and len(answer["queues"]) == 1
        return answer if found else None

    answer = eventually(complete)
    row = next(row for row in answer["channels"] if row["name"] == "overview/a")
    assert (row["held_bytes"], row["alive"], row["policy"]) == (5, True, "1 m")
    assert [one["name"] for one in answer["groups"]] == ["overview/group"]
    assert (answer["queues"][0]["held"], answer["hosts"][0]["alive"]) == (1, True)
    assert [one["leader"] for one in answer["supernodes"]] == [True]
    assert answer["notes"] == []


def test_the_time_line_has_each_item_and_marks_a_late_one(rt: st.Connection, page: LivePage) -> None:
    channel = rt.channel("line/a", max_age="10m")
    first = channel.put(b"1", duration="100ms")
    assert [one[2] for one in drawing(page, "line/a", first.time)["items"]] == [1]
    channel.put(b"late", time=first.time - 5 * SECOND)
    channel.put(b"3")

    def complete() -> dict[str, Any] | None:
        found = drawing(page, "line/a", first.time)
        return found if len(found["items"]) == 3 else None

    found = eventually(complete)
    assert [one[2] for one in found["items"]] == [2, 1, 3]
    assert [mark["kind"] for mark in found["marks"]] == ["late"]
    assert found["marks"][0]["at"] == pytest.approx(15e6)


def recorded(rt: st.Connection, name: str, count: int) -> tuple[st.Channel, int]:
    """Return a recorded channel whose memory holds its last three items, and the time of the first of `count` items."""
    channel, began = rt.channel(name, max_items=3, archive="forever"), st.now() - 3600 * SECOND
    for number in range(count):
        channel.put(b"%d" % number, time=began + number * MS)
    eventually(lambda: channel.stats().held == 3)
    return channel, began


def test_the_time_line_of_a_recorded_channel_reaches_into_its_archive(rt: st.Connection, page: LivePage) -> None:
    channel, began = recorded(rt, "tape/a", 10)
    found = drawing(page, "tape/a", began)
    assert found["archive_oldest"] == str(began) == str(channel.oldest().time)
    assert [one[2] for one in found["items"]] == list(range(1, 11))
    _, answer = page.ask("at", channel="tape/a", at=began + 4 * MS)
    assert answer["items"][0]["preview"]["text"] == "4"
    assert page.ask("step", channel="tape/a", at=-(2**63))[1] == {"time": str(began)}


def test_a_channel_that_is_not_recorded_has_no_archive(rt: st.Connection, page: LivePage) -> None:
    item = rt.channel("tape/none", max_age="10m").put(b"x")
    assert "archive_oldest" not in drawing(page, "tape/none", item.time)


def test_the_page_reads_a_window_before_its_track_without_a_change_of_the_track(
    rt: st.Connection, cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel, began = recorded(rt, "tape/long", 30)
    monkeypatch.setattr(following, "PAGE_ITEMS", 4)
    monkeypatch.setattr(following, "REFRESH_NANOS", 0)
    window = Window(start=began + MS, end=began + 10 * MS, width=100)
    at_the_start = Window(start=began, end=began + 2 * MS, width=100)

    async def look() -> list[tuple[list[int], bool]]:
        async with aio.connect(cluster.address) as connection:
            followed = following.FollowedChannel(await connection.channel(channel.name, create=False))
            seen = []
            for one in (window, at_the_start):
                await followed.refresh(one, None)
                track = followed.track_for(one)
                seen.append((list(track.seqs), track.ends_early))
            assert list(followed.track.seqs) == [27, 28, 29, 30]
            assert followed.failure == ""
            return seen

    assert asyncio.run(look()) == [([2, 3, 4, 5], True), ([1, 2, 3], False)]


def test_an_instant_shows_its_item_or_the_reason_for_none(rt: st.Connection, page: LivePage) -> None:
    channel = rt.channel("at/json", max_age="10m", codec="json")
    first = channel.put({"x": 1})
    second = channel.put({"x": 2})
    _, then = page.ask("at", channel="at/json", at=first.time)
    _, newest = page.ask("at", channel="at/json", at="newest")
    _, before = page.ask("at", channel="at/json", at=first.time - 1)
    assert then["items"][0]["item"]["time"] == str(first.time)
    assert then["items"][0]["preview"]["numbers"] == {"x": 1.0}
    assert newest["items"][0]["item"]["seq"] == second.seq
    assert "item" not in before["items"][0]
    assert before["items"][0]["reason"] == "NEVER"


def test_steps_go_from_item_to_item(rt: st.Connection, page: LivePage) -> None:
    channel = rt.channel("step/a", max_age="10m")
    first, second = channel.put(b"1"), channel.put(b"2")
    assert page.ask("step", channel="step/a", at=first.time)[1] == {"time": str(second.time)}
    assert page.ask("step", channel="step/a", at=second.time, direction="previous")[1] == {"time": str(first.time)}
    assert page.ask("step", channel="step/a", at=second.time)[1] == {"time": None}


def test_a_page_of_a_group_shows_the_items_that_the_group_shows(rt: st.Connection, page: LivePage) -> None:
    ahead, behind = rt.channel("through/ahead", max_age="10m"), rt.channel("through/behind", max_age="10m")
    group = rt.group("through", [ahead, behind])
    item = ahead.put(b"ahead")
    _, alone = page.ask("at", channel="through/ahead", at=item.time)
    _, through = page.ask("at", channel="through/ahead", at=item.time, group=group.name)
    assert alone["items"][0]["item"]["seq"] == item.seq
    assert through["items"][0]["reason"] == "HIDDEN"


def test_a_picture_is_served_as_it_was_put_and_never_as_markup(rt: st.Connection, page: LivePage) -> None:
    png = png_of(np.zeros((4, 4), dtype=np.uint8)) or b""
    rt.channel("picture/a", max_age="10m", content_type="image/png").put(png)
    rt.channel("picture/evil", max_age="10m", content_type="text/html").put(b"<script>alert(1)</script>")
    _, answer = page.ask("at", channel=["picture/a", "picture/evil"])
    picture, evil = answer["items"]
    with urlopen(page.url + picture["preview"]["url"]) as found:
        assert (found.read(), found.headers["content-type"]) == (png, "image/png")
        assert found.headers["x-content-type-options"] == "nosniff"
        assert "script-src 'self'" in found.headers["content-security-policy"]
    assert evil["preview"] == {"kind": "text", "text": "<script>alert(1)</script>"}


WRONG: list[tuple[str, dict[str, Any]]] = [
    ("timeline", {"channel": "a", "from": 0, "to": 1}),
    ("timeline", {"channel": "a", "from": 0, "to": 1, "width": 10**9}),
    ("timeline", {"channel": "a", "from": 5, "to": 5, "width": 10}),
    ("timeline", {"channel": "a", "from": "x", "to": 5, "width": 10}),
    ("timeline", {"channel": [f"c{n}" for n in range(65)], "from": 0, "to": 1, "width": 10}),
    ("at", {"at": "yesterday", "channel": "a"}),
    ("at", {}),
    ("step", {"channel": "step/a", "at": ""}),
]


@pytest.mark.parametrize(("path", "parameters"), WRONG)
def test_a_wrong_request_is_refused_with_a_sentence(path: str, parameters: dict[str, Any], page: LivePage) -> None:
    status, answer = page.ask(path, **parameters)
    assert status == 400
    assert answer["failure"]


def test_an_unknown_channel_does_not_make_other_channels_fail(rt: st.Connection, page: LivePage) -> None:
    rt.channel("known", max_age="10m").put(b"x")
    _, answer = page.ask("at", channel=["unknown", "known"])
    assert "unknown" in answer["items"][0]["failure"]
    assert answer["items"][1]["item"]["seq"] == 1


def test_a_request_under_the_name_of_another_site_is_refused(page: LivePage) -> None:
    request = Request(f"{page.url}api/overview", headers={"Host": "evil.example"})
    with pytest.raises(OSError, match="403"):
        urlopen(request)


def test_the_doctor_of_the_page_is_the_doctor_of_the_command_line(page: LivePage) -> None:
    _, answer = page.ask("doctor")
    assert {one["part"].split()[0] for one in answer["findings"]} >= {"front-end", "supernode", "host"}


def test_a_deleted_channel_leaves_the_page_and_a_new_one_of_its_name_is_shown(
    rt: st.Connection, page: LivePage
) -> None:
    first = rt.channel("again", max_age="10m")
    at = first.put(b"1").time
    drawing(page, "again", at)
    first.delete()
    eventually(gone(page, "again", at))
    second = rt.channel("again", max_age="10m").put(b"2")
    found = eventually(lambda: drawing(page, "again", at).get("items"))
    assert found[-1][2] == second.seq


def gone(page: LivePage, name: str, at: int) -> Callable[[], bool]:
    return lambda: "failure" in drawing(page, name, at)


def test_with_a_certificate_and_a_token_the_page_serves_other_machines_after_a_login(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    files = ClusterCertificates(tmp_path / "certs", host="localhost").issue(Role.FRONTEND, "page")
    ca, certificate, key = (str(path) for path in files.paths())
    token = tmp_path / "token"
    words = ["--tls-certificate", certificate, "--tls-key", key, "--token-file", str(token)]
    with live_page(cluster.address, *words) as page:
        opener = build_opener(HTTPSHandler(context=ssl.create_default_context(cafile=ca)), HTTPCookieProcessor())
        assert page.url.startswith("https://")
        with pytest.raises(OSError, match="401"):
            opener.open(f"{page.url}api/overview", timeout=ANSWER_SECONDS)
        assert token.stat().st_mode & 0o777 == 0o600
        opener.open(f"{page.url}login", urlencode({"token": token.read_text()}).encode(), timeout=ANSWER_SECONDS)
        with opener.open(f"{page.url}api/overview", timeout=ANSWER_SECONDS) as answer:
            assert b'"supernodes"' in answer.read()


def test_beyond_loopback_a_page_without_a_login_does_not_start(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--listen", "0.0.0.0:0"]) == 2
    assert "--token-file" in capsys.readouterr().err
