"""`stampede record` and `stampede file ...`, as typed at a shell."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt.cli import record
from stampede_rt.cli.commands import parser_of
from stampede_rt.cli.main import main
from stampede_rt.files.entries import Topic, item_entry
from stampede_rt.files.reading import FileReader
from stampede_rt_local.cluster import LocalCluster
from tests.support.files.recordings import INCARNATION, entries, gap, item, read, seqs_of, topic, write
from tests.support.processes import started
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import wait_until

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

    def command(*words: str | Path) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main([str(word) for word in words])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return command


def test_the_held_items_of_a_channel_are_recorded_to_a_file(run: Command, rt: st.Connection, tmp_path: Path) -> None:
    channel, path = rt.channel("flight", max_age="60s"), tmp_path / "a.mcap"
    for number in range(5):
        channel.put(b"%d" % number)
    status, out, error_output = run("record", "fli*", "--since", "30s", "--for", "0s", "-o", path)
    assert (status, out.splitlines()[1].split()[:4]) == (0, ["flight", "5", "5", "0"])
    assert "recording flight" in error_output
    status, out, _ = run("file", "info", path)
    assert status == 0
    assert "stampede-rt" in out
    shown = json.loads(run("file", "info", path, "--summary", "json")[1])
    assert shown["recording"][0]["recorded"] == 5
    assert run("file", "verify", path)[0] == 0


def test_the_status_is_3_if_anything_is_missing(run: Command, rt: st.Connection, tmp_path: Path) -> None:
    channel = rt.channel("narrow", max_items=2)
    for number in range(5):
        channel.put(b"%d" % number)
    status, out, _ = run("record", "narrow", "--since", "30s", "--for", "0s", "-o", tmp_path / "a.mcap")
    assert status == 3
    assert "missing: narrow: an unknown number of items: COLLECTED" in out
    assert run("file", "verify", tmp_path / "a.mcap")[0] == 3
    status, out, _ = run("record", "nobody", "--for", "0s", "-o", tmp_path / "b.mcap", "--summary", "json")
    assert status == 3
    assert json.loads(out)["absent"] == ["no channel matches 'nobody'"]


def recording(cluster: LocalCluster, *words: str | Path) -> list[str]:
    return [sys.executable, "-m", "stampede_rt.cli", "record", "--url", cluster.address, *map(str, words)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_sigterm_and_sighup_are_the_regular_end_of_a_recording(
    cluster: LocalCluster, rt: st.Connection, tmp_path: Path, number: signal.Signals
) -> None:
    channel, path = rt.channel(f"until/{number.name}"), tmp_path / "a.mcap"
    with started(recording(cluster, channel.name, "-o", path), stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        assert "until Ctrl-C" in process.stderr.readline()
        for at in range(10):
            channel.put(b"%d" % at)
        process.send_signal(number)
        out, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert out.splitlines()[1].split()[:4] == [channel.name, "10", "10", "0"]
    with FileReader(path) as reader:
        assert reader.index is not None


def test_a_recording_that_is_killed_can_be_recovered(
    cluster: LocalCluster, rt: st.Connection, run: Command, tmp_path: Path
) -> None:
    channel, path, saved = rt.channel("killed", max_age="60s"), tmp_path / "a.mcap", tmp_path / "b.mcap"
    with started(recording(cluster, "killed", "-o", path), stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        process.stderr.readline()
        for _ in range(30):
            channel.put(os.urandom(100_000))
        wait_until(lambda: path.exists() and path.stat().st_size > 20 * 100_000)  # an empty file cannot be read
        wait_until(lambda: len(seqs_of(read(path)[0], "killed")) >= 20)
        process.send_signal(signal.SIGKILL)
    status, out, error_output = run("file", "recover", path, "-o", saved)
    assert status == 3  # the file does not say whether later items existed
    seqs = seqs_of(read(saved)[0], "killed")
    assert seqs == list(range(1, len(seqs) + 1))
    assert len(seqs) >= 20
    assert f"killed: an unknown number of items, seq {len(seqs) + 1} to ?: DAMAGED" in out
    assert "the file ends without its end mark" in error_output
    (tmp_path / "begun.mcap").write_bytes(path.read_bytes()[:40])
    status, out, error_output = run(
        "file", "recover", tmp_path / "begun.mcap", "-o", tmp_path / "c.mcap", "--output", "json"
    )
    assert (status, out, (tmp_path / "c.mcap").exists()) == (1, "", False)
    assert "begun.mcap" in error_output
    held = {one.seq: one.payload for one in channel.get(st.OLDEST, st.NOW)}
    assert all(held[one.seq or 0] == one.data for one in read(saved)[0] if getattr(one, "seq", None))
    assert run("file", "verify", saved)[0] == 3


def test_each_item_of_an_event_channel_begins_a_file(cluster: LocalCluster, rt: st.Connection, tmp_path: Path) -> None:
    channel, events = rt.channel("on/data", max_age="60s"), rt.channel("on/crash")
    channel.put(b"before")
    (tmp_path / "crash-000002.mcap").write_bytes(b"of an earlier incarnation of the events")
    words = ["on/data", "--on", "on/crash", "--since", "30s", "--for", "0s", "-o", tmp_path / "crash.mcap"]
    with started(recording(cluster, *words), stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        process.stderr.readline()
        for name in ("crash-000001.mcap", "crash-000002-2.mcap"):
            wait_until(lambda: events.stats().subscriptions == 1)
            events.put(b"crash")
            path = tmp_path / name
            wait_until(lambda path=path: path.exists() and _is_finished(path))
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert process.returncode == 0
    assert len(list(tmp_path.iterdir())) == 3
    assert seqs_of(read(tmp_path / "crash-000002-2.mcap")[0], "on/data") == [1]


def _is_finished(path: Path) -> bool:
    try:
        with FileReader(path) as reader:
            return reader.index is not None
    except st.FileError:  # nothing is written yet
        return False


def test_an_event_above_the_limit_is_named_and_the_status_is_3(
    rt: st.Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(record, "PARALLEL_RECORDINGS_MAX", 1)
    events, notes = rt.channel("limit/events"), []
    words = ["record", "limit/*", "--on", "limit/events", "--for", "1h", "-o", str(tmp_path / "a.mcap")]
    recordings = record._EventRecordings(rt, parser_of("record").parse_args(words))
    thread = threading.Thread(target=lambda: notes.append(recordings.run()))
    thread.start()
    wait_until(lambda: events.stats().subscriptions == 1)
    events.put(b"1")
    events.put(b"2")
    wait_until(lambda: recordings._incomplete)
    recordings._stop()
    thread.join(30)
    assert notes == [3]
    assert "event #2 has no file: 1 recordings are under way" in capsys.readouterr().err
    assert _is_finished(tmp_path / "a-000001.mcap")


def test_wrong_usage_names_the_right_usage(run: Command, tmp_path: Path) -> None:
    status, _, error_output = run("record", "any", "--on", "event", "-o", tmp_path / "a.mcap")
    assert (status, "--on needs --for" in error_output) == (2, True)
    status, _, error_output = run("record", "any", "--since", "30", "-o", tmp_path / "a.mcap")
    assert (status, "--since" in error_output) == (2, True)
    status, _, error_output = run("file", "info", tmp_path / "none.mcap")
    assert (status, "No such file" in error_output) == (1, True)
    assert not list(tmp_path.iterdir())


def test_files_are_cut_and_merged(run: Command, tmp_path: Path) -> None:
    one = write(tmp_path / "1.mcap", [*entries("cam", range(1, 11)), gap("cam", 11, 15)])
    two = write(tmp_path / "2.mcap", entries("cam", range(8, 21)))
    both = tmp_path / "3.mcap"
    status, out, _ = run("file", "merge", one, two, "-o", both)
    assert (status, out.splitlines()[1].split()[:4]) == (0, ["cam", "20", "20", "0"])
    start = item(5).time
    status, out, _ = run("file", "cut", both, "--from", start, "--to", start + 3_000_000, "-o", tmp_path / "4.mcap")
    assert seqs_of(read(tmp_path / "4.mcap")[0]) == [5, 6, 7]
    assert run("file", "cut", both, "--channel", "imu", "-o", tmp_path / "5.mcap")[1:] == (
        f"{tmp_path / '5.mcap'} has no channels\n", f"stampede: {tmp_path / '5.mcap'} has no items\n",
    )  # fmt: skip


def test_names_in_a_hostile_file_are_escaped_at_the_terminal(run: Command, tmp_path: Path) -> None:
    bad = Topic("\x1b]0;title\x07cam", "json\x1b[2J", INCARNATION)
    path = write(tmp_path / "a.mcap", [item_entry(bad, item(1)), gap("\x1b[31mgap", 1, 2)])
    for verb in ("info", "verify"):
        _, out, error_output = run("file", verb, path)
        assert "\x1b" not in out + error_output
        assert "\\x1b" in out


def test_info_on_a_torn_file_gives_advice(run: Command, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 30)), finish=False)
    status, _, error_output = run("file", "info", path)
    assert (status, "`stampede file recover`" in error_output) == (1, True)
    status, _, error_output = run("file", "verify", path)
    assert (status, "ends without its end mark" in error_output) == (1, True)


def test_the_help_loads_no_library_of_files() -> None:
    code = "import sys; from stampede_rt.cli.commands import run\ntry: run(['--help'])\nexcept SystemExit: pass\n"
    code += "libraries = ('mcap', 'lz4', 'zstandard', 'rosbags', 'pyxdf', 'pyarrow', 'numpy')\n"
    code += "print([name for name in libraries if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "[]"


def test_without_the_library_the_error_names_the_extra(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = ("mcap", "stampede_rt.files.w", "stampede_rt._sync.rec")
    for name in [one for one in sys.modules if one.startswith(loaded)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    status, _, error_output = run("record", "any", "--for", "0s", "-o", tmp_path / "a.mcap")
    assert (status, "pip install 'stampede-rt[files]'" in error_output) == (1, True)


def test_two_threads_of_a_recording_do_not_share_a_turn(rt: st.Connection, tmp_path: Path) -> None:
    channels = [rt.channel(f"many/{number}") for number in range(8)]
    with rt.record("many/*", tmp_path / "a.mcap") as recorder:
        threads = [threading.Thread(target=lambda one=one: [one.put(b"x") for _ in range(25)]) for one in channels]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert recorder.summary is not None
    assert [one.recorded for one in recorder.summary.channels] == [25] * 8


def test_a_file_is_replayed_and_imported(run: Command, rt: st.Connection, tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.mcap", [*entries("cam", range(1, 11)), gap("cam", 11, 12), *entries("cam", range(13, 15))]
    )
    status, out, error_output = run("replay", path, "--as", "played/", "--speed", "max", "--shift", "now")
    assert (status, out.splitlines()[1].split()) == (3, ["played/cam", "12"])
    assert "missing in the file: cam: 2 items, seq 11 to 12: COLLECTED: too slow" in out
    assert "into played/cam" in error_output
    words = ("import", path, "--as", "kept/", "--channel", "c*", "--from", item(5).time, "--summary", "json")
    status, out, _ = run(*words)
    assert (status, json.loads(out)["items"], json.loads(out)["complete"]) == (3, {"kept/cam": 8}, False)
    assert len(rt.channel("kept/cam", create=False).get(st.OLDEST, st.NEWEST)) == 8
    status, out, _ = run(*words, "--to", item(10).time)  # the gap comes later
    assert (status, json.loads(out)["items"], json.loads(out)["complete"]) == (0, {"kept/cam": 5}, True)


def test_the_commands_that_copy_a_recovered_file_name_everything_that_it_may_lack(run: Command, tmp_path: Path) -> None:
    """In an earlier version an import, a replay and a table of such a file had status 0 and named no loss."""
    whole = [item_entry(topic(encoding="json"), item(seq, b"1", content_type="application/json")) for seq in (1, 2)]
    torn, saved = write(tmp_path / "torn.mcap", whole, finish=False), tmp_path / "saved.mcap"
    assert run("file", "recover", torn, "-o", saved)[0] == 3
    for words in (
        ("import", saved, "--as", "saved/"),
        ("replay", saved, "--as", "again/", "--speed", "max"),
        ("export", saved, "-o", tmp_path / "saved.csv"),
        ("file", "cut", saved, "-o", tmp_path / "cut.mcap"),
        ("file", "merge", saved, "-o", tmp_path / "merged.mcap"),
    ):
        status, out, error_output = run(*words)
        assert (status, "had no end, so items of channels that the file does not name may be missing" in out) == (
            3,
            True,
        ), error_output


def test_channels_are_replayed_with_their_durations_attributes_advances_and_gaps(
    run: Command, rt: st.Connection
) -> None:
    left, right = rt.channel("lab/left", max_items=4), rt.channel("lab/right", max_age="60s")
    began = st.now() - 2 * 10**9
    for number in range(6):
        left.put(b"%d" % number, time=began + number * 10**7, duration="5ms", attributes={"n": str(number)})
        right.put(b"%d" % number, time=began + number * 10**7 + 10**6)
    right.advance(began + 10**9)
    words = ("--as", "again/", "--speed", "max", "--shift", "now")
    status, out, error_output = run("replay", "lab/*", "--from", str(began), *words)
    assert status == 3  # the host had collected two items before the replay
    assert "into again/lab/left and again/lab/right" in error_output
    assert "missing in the file: lab/left: " in out
    played, other = (rt.channel(f"again/lab/{side}", create=False) for side in ("left", "right"))
    items, others = played.get(st.OLDEST, st.NEWEST), other.get(st.OLDEST, st.NEWEST)
    assert [(one.payload, one.duration) for one in items] == [(b"%d" % number, 5 * 10**6) for number in range(2, 6)]
    assert [one.attributes["n"] for one in items] == ["2", "3", "4", "5"]
    assert "stampede.gap" in items[0].attributes
    advance = other.stats().advance
    assert advance is not None
    assert (len(others), advance - others[0].time) == (6, 10**9 - 10**6)
    status, out, _ = run("replay", "lab/right", "--as", "part/", "--speed", "max", "--from", others_time(right, 2))
    assert (status, out.splitlines()[1].split()) == (0, ["part/lab/right", "4"])


def others_time(channel: st.Channel, index: int) -> int:
    return channel.get(st.OLDEST, st.NEWEST)[index].time


def test_an_import_that_a_channel_would_refuse_ends_with_one_sentence(
    run: Command, rt: st.Connection, tmp_path: Path
) -> None:
    rt.channel("window/cam", max_age="5s")
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 11)))
    status, _, error_output = run("import", path, "--as", "window/")
    assert (status, error_output.count("\n")) == (2, 1)
    assert "channel 'window/cam' would refuse items of the file: it keeps items for 5 s" in error_output
    assert rt.channel("window/cam").stats().accepted == 0


def test_ctrl_c_is_the_regular_end_of_a_loop(cluster: LocalCluster, rt: st.Connection, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 11)))
    words = ["replay", "--url", cluster.address, str(path), "--as", "looped/", "--loop", "--shift", "now"]
    with started([sys.executable, "-m", "stampede_rt.cli", *words], stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        process.stderr.readline()
        channel = rt.channel("looped/cam", create=False)
        wait_until(lambda: channel.stats().accepted > 20)
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert out.splitlines()[1].split() == ["looped/cam", str(channel.stats().accepted)]


@pytest.mark.parametrize("words", [("--speed", "0"), ("--speed", "fast"), ("--loop",), ("--shift", "soon")])
def test_a_replay_with_wrong_usage_puts_nothing(run: Command, tmp_path: Path, words: tuple[str, ...]) -> None:
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 11)))
    try:
        status = run("replay", path, "--as", "wrong/", *words)[0]
    except SystemExit as ended:
        status = ended.code
    assert status == 2


def test_the_items_of_channels_are_exported(run: Command, rt: st.Connection, tmp_path: Path) -> None:
    channel = rt.channel("export/json", codec="json", max_age="60s")
    rt.channel("export/arrays", codec="numpy", max_age="60s").put([[1, 2], [3, 4]])
    for number in range(3):
        channel.put({"n": number})
    status, out, _ = run("export", "export/json", "-o", tmp_path / "a.csv")
    assert (status, out.splitlines()[1].split()) == (0, [str(tmp_path / "a.csv"), "3"])
    assert (tmp_path / "a.csv").read_text().splitlines()[0] == "time,duration,seq,attributes,value.n"
    assert run("export", "export/*", "-o", tmp_path / "both", "--format", "parquet")[0] == 0
    assert sorted(one.name for one in (tmp_path / "both").iterdir()) == ["export_arrays.parquet", "export_json.parquet"]
    assert run("export", "export/*", "-o", tmp_path / "a.mcap")[0] == 0
    assert seqs_of(read(tmp_path / "a.mcap")[0], "export/json") == [1, 2, 3]
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.csv", "a.mcap", "both"]
    status, out, _ = run("export", tmp_path / "a.mcap", "--channel", "*/json", "-o", tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "a.csv").read_bytes()


def test_an_export_without_a_format_or_a_source_is_refused(run: Command, tmp_path: Path) -> None:
    status, _, error_output = run("export", "cam", "-o", tmp_path / "a.txt")
    assert (status, "give --format" in error_output) == (2, True)
    status, _, error_output = run("export", "nobody", "-o", tmp_path / "a.csv")
    assert (status, "there is no file and no channel nobody" in error_output) == (2, True)
    assert not list(tmp_path.iterdir())
