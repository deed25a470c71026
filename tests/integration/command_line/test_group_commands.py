"""`stampede group ...`, as typed at a shell."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=2)
SECOND = 1_000_000_000
Command = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


@pytest.fixture
def run(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Run a command. Returns its exit status and its output."""
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)

    def command(*words: str) -> tuple[int, str, str]:
        status = main(["group", *words])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return command


@pytest.fixture(scope="module")
def base(rt: st.Connection) -> int:
    """Two channels at two hosts. The cut of their group is two seconds after the returned time."""
    base = st.now() - 20 * SECOND
    for name, host in zip(("rig/left", "rig/right"), sorted(host.name for host in rt.hosts()), strict=True):
        channel = rt.channel(name, max_age="120s", host=host)
        for number in range(3 if name == "rig/right" else 5):
            channel.put(b"%d" % number, time=base + number * SECOND)
    return base


def test_a_group_is_made_listed_and_deleted(run: Command, base: int) -> None:
    assert run("create", "short", "rig/left", "rig/right", "--idle-after", "3s") == (
        0,
        "short: rig/left, rig/right\n",
        "",
    )
    listed = json.loads(run("ls", "sh*", "-o", "json")[1])
    assert [(row["group"], row["channels"], row["idle_after"]) for row in listed] == [
        ("short", ["rig/left", "rig/right"], 3_000_000_000)
    ]
    assert run("remove", "short", "rig/right")[1] == "short: rig/left\n"
    assert run("add", "short", "rig/right")[1] == "short: rig/left, rig/right\n"
    assert "its channels stay" in run("delete", "short")[1]
    status, _, error_output = run("status", "short")
    assert status == 1
    assert "short" in error_output


def test_the_status_of_a_group_names_the_channel_that_holds_it_back(run: Command, rt: st.Connection, base: int) -> None:
    run("create", "rig", "rig/left", "rig/right")
    rt.group("rig")["rig/left"].get(base + SECOND, base + SECOND, match="start", timeout=10)
    status, printed, _ = run("status", "rig")
    assert status == 0
    assert "rig/right holds it back" in printed
    left, right = (
        next(line for line in printed.splitlines() if line.startswith(f"rig/{side} ")) for side in ("left", "right")
    )
    assert ("at the cut" in left, "at the cut" in right) == (False, True)
    newest = json.loads(run("newest", "rig", "-o", "json")[1])
    assert [newest[name][0]["payload"] for name in ("rig/left", "rig/right")] == ["1", "1"]
    shown = run("get", "rig", "oldest", "newest")[1]
    assert shown.count("rig/left") == shown.count("rig/right") == 2


def test_a_group_without_visible_items_has_a_reason_for_each_channel(run: Command, rt: st.Connection) -> None:
    for name, host in zip(("early", "late"), sorted(host.name for host in rt.hosts()), strict=True):
        rt.channel(name, max_age="60s", host=host).put(b"first")
    run("create", "young", "early", "late")
    for words in (("newest", "young"), ("get", "young", "oldest", "newest"), ("newest", "young", "-o", "json")):
        status, _, error_output = run(*words)
        assert status == 3
        for name in ("early", "late"):
            assert any(
                line.startswith(f"stampede: {name}: HIDDEN: the group hides items")
                for line in error_output.splitlines()
            )


def test_cuts_and_matches_are_printed_when_they_arrive(
    cluster: LocalCluster, run: Command, rt: st.Connection, base: int
) -> None:
    run("create", "live", "rig/left", "rig/right")
    left, right = rt.channel("rig/left"), rt.channel("rig/right")
    stop = threading.Event()

    def put() -> None:
        for number in range(5, 10_000):
            left.put(b"%d" % number, time=base + number * SECOND // 100 + 6 * SECOND)
            right.put(b"%d" % number, time=base + number * SECOND // 100 + 6 * SECOND)
            if stop.wait(0.05):
                return

    producer = threading.Thread(target=put)
    producer.start()
    try:
        cut = json.loads(run("watch", "live", "-n", "1", "-o", "jsonl")[1])
        words = ["match", "live", "--per", "rig/left", "--tolerance", "1ms", "-n", "1", "-o", "jsonl"]
        match = json.loads(run(*words)[1])
        unique = json.loads(run(*words, "--unique", "--lateness", "20ms")[1])
        waited = json.loads(run("watch", "live", "-n", "1", "-o", "jsonl", "--lateness", "20ms")[1])
        assert run(*words, "--lateness=-1s")[0] != 0
    finally:
        stop.set()
        producer.join()
    assert cut["incomplete"] == []
    assert waited["incomplete"] == []
    assert match["missing"] == unique["missing"] == []
    assert match["items"]["rig/left"]["payload"] == match["items"]["rig/right"]["payload"]


@pytest.mark.parametrize("words", [["status"], ["newest"], ["get", "oldest", "newest"], ["watch"], ["delete"]])
def test_an_unknown_group_is_reported_with_advice_for_the_shell(run: Command, words: list[str]) -> None:
    verb, *rest = words
    status, _, error_output = run(verb, "rig/nowhere", *rest)
    assert (status, "`stampede group ls` lists" in error_output) == (1, True)
