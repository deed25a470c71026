"""Each verb on a pseudo-terminal, against one running cluster."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from itertools import count

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.command_line.terminal import Screen, run_in_terminal
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=1, supernodes=1, scope="module")
Terminal = Callable[..., Screen]


@pytest.fixture(scope="module")
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret_file.read_text().strip()) as connection:
        yield connection


@pytest.fixture
def terminal(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Runs one command on a terminal. Fails if its status is another one, or if it writes control characters."""
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.delenv("LINES", raising=False)

    def run(*words: str, status: int = 0, columns: int = 100, typed: bytes = b"") -> Screen:
        screen = run_in_terminal(words, columns=columns, typed=typed)
        assert screen.status == status, screen
        assert screen.controls(screen=words[0] == "top") == set(), screen
        return screen

    return run


def test_rm_deletes_channels_and_names_those_that_are_not_there(rt: st.Connection, terminal: Terminal) -> None:
    rt.channel("rm/a")
    rt.channel("rm/b")
    said = terminal("rm", "rm/a", "rm/none", "rm/b", status=1).text
    assert "rm/a is deleted" in said
    assert "there is no channel rm/none" in said
    assert "rm/b is deleted" in said
    assert rt.channels("rm/*") == []


def test_rm_of_a_glob_deletes_nothing_without_yes(rt: st.Connection, terminal: Terminal) -> None:
    rt.channel("rm/glob/a")
    rt.channel("rm/glob/b")
    said = terminal("rm", "rm/glob/*", status=2).text
    assert "matches 2 channels (rm/glob/a, rm/glob/b); nothing is deleted; --yes deletes them" in " ".join(said.split())
    assert len(rt.channels("rm/glob/*")) == 2
    rows = json.loads(terminal("rm", "rm/glob/*", "--yes", "-o", "json").text)
    assert rows == [{"channel": f"rm/glob/{name}", "deleted": True} for name in "ab"]
    assert "no channel matches 'rm/glob/*'" in terminal("rm", "rm/glob/*", "--yes", status=2).text


def test_configure_changes_the_stated_settings_and_prints_the_policy(rt: st.Connection, terminal: Terminal) -> None:
    rt.channel("configured", max_items=5)
    assert "30 s, 5 items" in terminal("configure", "configured", "--max-age", "30s").text
    policy = json.loads(terminal("configure", "configured", "--max-items", "7", "-o", "jsonl").text)
    assert (policy["channel"], policy["max_age_nanos"], policy["max_items"]) == ("configured", 30 * 10**9, 7)
    assert "state at least one setting" in terminal("configure", "configured", status=2).text
    assert "there is no channel absent" in terminal("configure", "absent", "--max-age", "1s", status=1).text


def while_something_happens(happen: Callable[[int], object], look: Callable[[], Screen]) -> Screen:
    """The end of the command `look`. Meanwhile `happen` is called again and again, with 0, 1, 2, ..."""
    screens: list[Screen] = []
    thread = threading.Thread(target=lambda: screens.append(look()))
    thread.start()
    numbers = count()
    wait_until(lambda: happen(next(numbers)) and not thread.is_alive())
    return screens[0]


def test_watch_prints_channels_as_they_come_and_go(rt: st.Connection, terminal: Terminal) -> None:
    def come_and_go(number: int) -> bool:
        rt.channel(f"other/{number}").delete()
        rt.channel(f"watched/{number}").delete()
        return True

    text = while_something_happens(come_and_go, lambda: terminal("watch", "watched/*", "--count", "3")).text
    assert "+ channel watched/" in text
    assert "- channel watched/" in text
    assert "other" not in text


def test_watch_prints_peers_as_they_come_and_go(cluster: LocalCluster, terminal: Terminal) -> None:
    def come_and_go(number: int) -> bool:
        st.connect(cluster.address, secret=cluster.secret_file.read_text().strip(), name=f"passer/{number}").close()
        return True

    screen = while_something_happens(come_and_go, lambda: terminal("watch", "passer/*", "--count", "2", "-o", "jsonl"))
    rows = [json.loads(line) for line in screen.lines]
    assert {row["kind"] for row in rows} == {"peer"}
    assert rows[0]["index"] < rows[1]["index"]
