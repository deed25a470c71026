"""`stampede replay` of channels, as typed at a shell: the items between two instants, or none."""

from __future__ import annotations

import errno
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main
from stampede_rt.files.writing import FileWriter
from stampede_rt.values.timeline import format_instant
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


@pytest.fixture
def run(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Run a command. Returns its exit status and its output."""
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)

    def command(*words: str) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main(list(words))
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return command


def test_a_replay_ignores_later_items_when_it_checks_which_items_the_channel_takes(
    run: Command, rt: st.Connection
) -> None:
    channel, began = rt.channel("until/cam", max_age="60s"), st.now() - 30 * 10**9
    for number in range(10):
        channel.put(b"%d" % number, time=began + number * 10**9)
    words = ("--from", str(began), "--to", str(began + 2 * 10**9), "--as", "cut/", "--speed", "max", "--shift", "now")
    status, out, error_output = run("replay", "until/cam", *words, "-o", "json")
    assert (status, json.loads(out)["items"]) == (0, {"cut/until/cam": 2}), error_output


@pytest.mark.parametrize("verb", ["replay", "export"])
def test_a_full_disk_is_told_without_advice_to_recover_a_removed_file(
    run: Command, rt: st.Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    rt.channel("full/cam", max_age="60s").put(b"x")
    monkeypatch.setattr(FileWriter, "_add", full)
    output = ["--file", str(tmp_path / "a.mcap")] if verb == "export" else ["--as", "full-again/"]
    status, _, error_output = run(verb, "full/cam", *output)
    assert status == 1
    assert "No space left on device; free space; no new file was written" in error_output
    assert "recover" not in error_output
    assert ("$TMPDIR" in error_output) is (verb == "replay")
    assert not list(tmp_path.iterdir())


def test_a_replay_makes_no_channel_for_a_topic_without_items_in_its_interval(
    run: Command, rt: st.Connection, tmp_path: Path
) -> None:
    began, path = st.now() - 30 * 10**9, tmp_path / "two.mcap"
    early, late = rt.channel("some/early", max_age="60s"), rt.channel("some/late", max_age="60s")
    for number in range(4):
        early.put(b"%d" % number, time=began + number)
        late.put(b"%d" % number, time=began + 10 * 10**9 + number)
    late.advance(began + 20 * 10**9)
    assert run("record", "some/*", "--since", "60s", "--for", "0s", "-o", str(path))[0] == 0
    words = ("--to", str(began + 10**9), "--as", "part/", "--speed", "max", "--shift", "now")
    status, out, error_output = run("replay", str(path), *words, "-o", "json")
    assert (status, json.loads(out)["items"]) == (0, {"part/some/early": 4}), error_output
    assert "part/some/late" not in [one.name for one in rt.channels()]


def test_a_replay_of_a_time_between_two_items_says_so_and_makes_no_channel(
    run: Command, rt: st.Connection, tmp_path: Path
) -> None:
    channel, began = rt.channel("pause/cam", max_age="60s"), st.now() - 30 * 10**9
    for number in (0, 20):
        channel.put(b"%d" % number, time=began + number * 10**9)
    start, end = began + 5 * 10**9, began + 6 * 10**9
    window = f"from {format_instant(start)} on and before {format_instant(end)}"
    words = ("--from", str(start), "--to", str(end), "--as", "hole/", "--speed", "max", "--shift", "now")
    status, _, error_output = run("replay", "pause/cam", *words)
    assert (status, error_output) == (2, f"stampede: channel 'pause/cam' has no items {window}\n")
    path = tmp_path / "pause.mcap"
    assert run("record", "pause/cam", "--since", "60s", "--for", "0s", "-o", str(path))[0] == 0
    status, _, error_output = run("replay", str(path), *words)
    expected = f"stampede: the file {str(path)!r} has no items of the chosen topics {window}\n"
    assert (status, error_output) == (2, expected)
    assert "hole/pause/cam" not in [one.name for one in rt.channels()]


def test_a_replay_of_channels_without_items_names_them_and_the_instants(run: Command, rt: st.Connection) -> None:
    channel, began = rt.channel("none/cam", max_items=2), st.now() - 60 * 10**9
    for number in range(5):
        channel.put(b"%d" % number, time=began + number * 10**9)
    channel.advance(began + 20 * 10**9)
    late, end = began + 40 * 10**9, began + 50 * 10**9
    text = f"stampede: channel 'none/cam' has no items from {format_instant(late)} on and before "
    status, _, error_output = run("replay", "none/cam", "--from", str(late), "--to", str(end), "--shift", "now")
    assert (status, error_output) == (2, f"{text}{format_instant(end)}\n")
    status, _, error_output = run("replay", "none/cam", "--from", str(began), "--to", str(began + 1), "--shift", "now")
    assert (status, "channel 'none/cam' has no items from" in error_output, "COLLECTED" in error_output) == (
        2,
        True,
        True,
    )
    rt.channel("none/too")
    status, _, error_output = run("replay", "none/too", "--shift", "now")
    assert (status, error_output) == (2, "stampede: channel 'none/too' has no items\n")
