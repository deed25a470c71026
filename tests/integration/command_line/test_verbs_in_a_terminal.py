"""Each verb on a pseudo-terminal, against one running cluster."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.command_line.terminal import TerminalRun, run_in_terminal
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import wait_until

cluster = shared_cluster_fixture(hosts=1)
Terminal = Callable[..., TerminalRun]


@pytest.fixture(scope="module")
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret_file.read_text().strip()) as connection:
        yield connection


@pytest.fixture
def terminal(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Runs one command on a terminal. Fails if the command ends with another status than `status`, or writes control
    characters.
    """
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("COLUMNS", raising=False)
    monkeypatch.delenv("LINES", raising=False)

    def run(*words: str, status: int = 0, progress: bool = False, **terminal: Any) -> TerminalRun:
        screen = run_in_terminal(words, **terminal)
        assert screen.status == status, screen
        moves = {"\r"} if progress else set()
        assert screen.controls(moves_cursor=progress or words[0] == "top") <= moves, screen
        return screen

    return run


def test_rm_deletes_channels_and_names_the_unknown_ones(rt: st.Connection, terminal: Terminal) -> None:
    rt.channel("rm/a")
    rt.channel("rm/b")
    text = terminal("rm", "rm/a", "rm/none", "rm/b", status=1).text
    assert "rm/a is deleted" in text
    assert "there is no channel rm/none" in text
    assert "rm/b is deleted" in text
    assert rt.channels("rm/*") == []


def test_rm_of_a_glob_deletes_nothing_without_yes(rt: st.Connection, terminal: Terminal) -> None:
    rt.channel("rm/glob/a")
    rt.channel("rm/glob/b")
    text = terminal("rm", "rm/glob/*", status=2).text
    assert "matches 2 channels (rm/glob/a, rm/glob/b); nothing is deleted; --yes deletes them" in " ".join(text.split())
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


def run_during_changes(change: Callable[[int], object], command: Callable[[], TerminalRun]) -> TerminalRun:
    """Run `command` to its end, and call `change` meanwhile, with 0, 1, 2, ... Returns the run of the command."""
    screens: list[TerminalRun] = []
    thread = threading.Thread(target=lambda: screens.append(command()))
    thread.start()
    numbers = count()
    wait_until(lambda: change(next(numbers)) and not thread.is_alive())
    return screens[0]


def test_watch_prints_opened_and_deleted_channels(rt: st.Connection, terminal: Terminal) -> None:
    def come_and_go(number: int) -> bool:
        rt.channel(f"other/{number}").delete()
        rt.channel(f"watched/{number}").delete()
        return True

    text = run_during_changes(come_and_go, lambda: terminal("watch", "watched/*", "--count", "3")).text
    assert "+ channel watched/" in text
    assert "- channel watched/" in text
    assert "other" not in text


def test_watch_prints_peers_that_join_and_leave(cluster: LocalCluster, terminal: Terminal) -> None:
    def come_and_go(number: int) -> bool:
        st.connect(cluster.address, secret=cluster.secret_file.read_text().strip(), name=f"passer/{number}").close()
        return True

    screen = run_during_changes(come_and_go, lambda: terminal("watch", "passer/*", "--count", "2", "-o", "jsonl"))
    rows = [json.loads(line) for line in screen.lines]
    assert {row["kind"] for row in rows} == {"peer"}
    assert rows[0]["index"] < rows[1]["index"]


def test_sub_prints_the_items_of_all_matching_channels_by_time(rt: st.Connection, terminal: Terminal) -> None:
    now = st.now()
    for name, offset in (("left", 0), ("right", 5)):
        channel = rt.channel(f"sub/{name}", max_age="1h")
        for number in range(3):
            channel.put(b"%d" % number, time=now + (number * 10 + offset) * 10**6 - 10**9)
    rt.channel("other/sub").put(b"not this one")
    lines = terminal("sub", "sub/*", "--from", "oldest", "--count", "6", "--wait", "20s").lines
    assert [line.split("  ")[1].split()[0] for line in lines] == ["sub/left", "sub/right"] * 3


def test_sub_joins_channels_that_appear_later(rt: st.Connection, terminal: Terminal) -> None:
    def appear(number: int) -> bool:
        rt.channel(f"joined/{number}", max_age="1h").put(b"first item")
        return True

    screen = run_during_changes(appear, lambda: terminal("sub", "joined/*", "--count", "2", "-o", "jsonl"))
    assert {json.loads(line)["payload"] for line in screen.lines} == {"first item"}


def test_put_takes_one_item_for_each_line_of_standard_input(rt: st.Connection, terminal: Terminal) -> None:
    output = terminal("put", "lines", "--lines", "--max-age", "1h", typed=b"one\ntwo\nlast\n\x04")
    assert output.text == "lines: 3 items put\n"
    assert terminal("put", "lines", "--lines", "--max-age", "1h", typed=b"one\n\x04").text == "lines: 1 item put\n"
    assert [item.payload for item in rt.channel("lines").get(st.OLDEST, st.NEWEST)] == [b"one", b"two", b"last", b"one"]


def test_put_repeats_an_item_at_a_rate(rt: st.Connection, terminal: Terminal) -> None:
    text = terminal("put", "rated", "again", "--rate", "200", "--count", "20", "--max-age", "1h", "-o", "json").text
    assert json.loads(text) == {"channel": "rated", "accepted": 20, "rejected": 0}
    assert [item.payload for item in rt.channel("rated").get(st.OLDEST, st.NEWEST)] == [b"again"] * 20


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--lines", "text"], "--lines reads the payloads from standard input"),
        (["text", "--count", "3"], "--count needs --rate or --lines"),
        (["text", "--rate", "1", "--time", "5"], "--time is for one item"),
        (["text", "--rate", "0"], "'0' is not a rate"),
        (["text", "--rate", "1e-300"], "'1e-300' is not a rate"),
    ],
)
def test_put_refuses_options_that_exclude_each_other(terminal: Terminal, words: list[str], complaint: str) -> None:
    assert complaint in terminal("put", "refused", *words, status=2, columns=300).text


@pytest.mark.parametrize(
    ("words", "status", "complaint"),
    [
        (["ls", "\udcff"], 2, "an argument is not text in UTF-8"),
        (["move", "absent", "h1"], 1, "there is no channel absent; `stampede ls` lists the channels"),
        (["proxy", "ls", "absent"], 1, "there is no channel absent; `stampede ls` lists the channels"),
        (["get", "absent", "--format", "{seq:c}"], 2, "the format of 'seq' is not allowed"),
        (["put", "absent", "x", "--consumers", "9999999999"], 2, "below 2**32"),
        (["queue", "put", "absent", "x", "--copies", "9999999999"], 2, "below 2**32"),
        (["replay", "absent", "--shift", "-1h"], 2, "there is no file and no channel absent"),
        (["put", "absent", "x", "--duration", "-5s"], 2, "duration"),
    ],
)
def test_a_wrong_argument_is_reported_in_one_sentence(
    terminal: Terminal, words: list[str], status: int, complaint: str
) -> None:
    text = terminal(*words, status=status, progress=words[0] == "replay", columns=300).text
    assert complaint in text
    assert "expected one argument" not in text


def test_items_can_be_printed_for_people_in_a_given_format_and_in_local_time(
    rt: st.Connection, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    import numpy as np

    arrays = rt.channel("readable/arrays", codec="numpy", max_age="1h")
    arrays.put(np.arange(12, dtype="f4").reshape(3, 4))
    assert "float32 3x4 from 0 to 11: [0, 1, 2, 3, 4, 5, 6, 7, ...]" in terminal("get", "readable/arrays").text
    rt.channel("readable/json", codec="json", max_age="1h").put({"a": [1, 2]})
    assert '{"a": [1, 2]}' in terminal("echo", "readable/json", "--from", "oldest", "--count", "1").text
    rt.channel("readable/text").put(b"hi", time=10**9 * 1_700_000_000, attributes={"enc": "x\x1b"})
    form = r"{time}|{seq:03d}|{channel}\t{payload}|{length}|{attributes[enc]}|{attributes[none]}|{end_ns}"
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    time.tzset()
    try:
        text = terminal("get", "readable/text", "--all", "--local", "--format", form).text
    finally:
        monkeypatch.undo()
        time.tzset()
    assert text == "2023-11-15T07:13:20.000000000+09:00|001|readable/text\thi|2|x\\x1b||-\n"
    assert "the format has no field 'no'" in terminal("get", "readable/text", "--format", "{no}", status=2).text


def test_long_work_shows_its_progress_on_a_terminal_and_erases_it_at_the_end(
    rt: st.Connection, terminal: Terminal, tmp_path: Path
) -> None:
    channel = rt.channel("long/a", max_age="1h")
    for _ in range(3):
        channel.put(b"x")
    path = str(tmp_path / "a.mcap")
    screen = terminal("record", "long/a", "--since", "oldest", "--for", "1s", "-o", path, progress=True)
    assert "3 items of 1 channels in " in screen.written
    assert "%  3 items" in screen.written
    assert screen.written.count("\r\x1b[K") >= 2
    screen = terminal("import", path, "--as", "played/", "--output", "jsonl", progress=True)
    assert json.loads(screen.lines[-1].rpartition("\r")[2])["items"] == {"played/long/a": 3}
    facts = json.loads(terminal("file", "info", path, "--output", "jsonl").text)
    assert facts["messages"] >= 3


def test_hz_prints_the_rates_of_many_channels_with_jitter_and_lag(rt: st.Connection, terminal: Terminal) -> None:
    left, right = rt.channel("rig/left", max_age="1h"), rt.channel("rig/right", max_age="1h")

    def put(_: int) -> bool:
        left.put(b"x")
        right.put(b"x")
        return True

    screen = run_during_changes(put, lambda: terminal("hz", "rig/*", "--every", "0.5", "--count", "2"))
    assert screen.lines[0].split() == ["CHANNEL", "ITEMS/S", "REFUSED/S", "JITTER", "LAG", "HELD"]
    assert len([line for line in screen.lines if line.startswith("rig/")]) == 4
    command = lambda: terminal("hz", "rig/left", "--every", "0.5", "--count", "2", "-o", "jsonl")  # noqa: E731
    rows = [json.loads(line) for line in run_during_changes(put, command).lines]
    assert {row["channel"] for row in rows} == {"rig/left"}
    assert all(row["items_per_second"] > 0 and row["jitter_nanos"] > 0 and row["lag_nanos"] > 0 for row in rows)


def test_hz_ends_with_the_reason_when_its_channel_is_deleted(rt: st.Connection, terminal: Terminal) -> None:
    channel = rt.channel("hz/gone")
    command = lambda: terminal("hz", "hz/gone", "--every", "0.05", status=1)  # noqa: E731
    screen = run_during_changes(lambda number: number != 50 or channel.delete() is None, command)
    assert "hz/gone" in screen.lines[-1]


def test_keys_sort_pause_filter_and_end_top(rt: st.Connection, terminal: Terminal) -> None:
    rt.channel("top/one").put(b"x")
    rt.channel("top/two").put(b"x")
    text = terminal("top", "top/*", "--every", "0.2", answered=b"sp/two\nq", columns=120).text
    assert "sorted by items, paused" in text
    assert "filter: two" in text
    assert "top/one" in text


def test_top_fits_a_narrow_terminal(rt: st.Connection, terminal: Terminal) -> None:
    rt.channel("top/one").put(b"x")
    screen = terminal("top", "top/*", "--every", "0.1", "--count", "1", columns=50)
    assert "ITEMS/S" in screen.text
    assert "REFUSED/S" not in screen.text
    assert "\N{HORIZONTAL ELLIPSIS}" not in screen.text
