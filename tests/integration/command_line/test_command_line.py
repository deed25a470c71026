"""The command line as a user types it, against a real cluster."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import TESTER, judges_tests
from tests.support.command_line.redirected import run_redirected
from tests.support.processes import started
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
COMMAND = [sys.executable, "-m", "stampede_rt.cli"]
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def environment(cluster: LocalCluster) -> dict[str, str]:
    return os.environ | {"STAMPEDE_URL": cluster.address, "STAMPEDE_SECRET_FILE": str(cluster.secret_file)}


def checked(done: subprocess.CompletedProcess[bytes], status: int) -> subprocess.CompletedProcess[str]:
    text = subprocess.CompletedProcess(done.args, done.returncode, done.stdout.decode(), done.stderr.decode())
    assert "Traceback" not in text.stderr
    assert text.returncode == status, text
    return text


@pytest.fixture
def stampede(environment: dict[str, str]) -> Run:
    """Run a command in this process, with the cluster's secret. `following` and `process` start processes."""

    def run(*arguments: str, status: int = 0, stdin: bytes = b"") -> subprocess.CompletedProcess[str]:
        with pytest.MonkeyPatch.context() as patch:
            for name in ("STAMPEDE_URL", "STAMPEDE_SECRET_FILE"):
                patch.setenv(name, environment[name])
            return checked(run_redirected(arguments, stdin=stdin), status)

    return run


@pytest.fixture
def process(environment: dict[str, str]) -> Run:
    """Run a command as a process."""

    def run(*arguments: str, status: int = 0, stdin: bytes = b"", **more: str) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [*COMMAND, *arguments], env=environment | more, capture_output=True, input=stdin, timeout=40, check=False
        )
        return checked(done, status)

    return run


@pytest.fixture
def following(environment: dict[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start commands that run until Ctrl-C. At the end kills all that still run."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        process = subprocess.Popen([*COMMAND, *arguments], env=environment, text=True, **pipes)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def interrupt(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGINT)
    _, complaints = process.communicate(timeout=45)
    assert (process.returncode, complaints) == (130, "")


def test_put_and_get_print_lines_for_people(process: Run) -> None:
    put = process("put", "cli/a", "hello there", "--duration", "40ms", "--attribute", "enc=text")
    assert put.stdout.startswith("cli/a #")
    got = process("get", "cli/a")
    assert "hello there" in got.stdout
    assert "for 40 ms" in got.stdout
    assert "enc=text" in got.stdout


def test_options_may_stand_between_the_words(stampede: Run) -> None:
    stampede("put", "cli/order", "--duration", "40ms", "between")
    assert "between" in stampede("get", "cli/order", "--bounds", "[]", "oldest", "now", "--limit", "1").stdout


def test_get_prints_json_for_programs(stampede: Run) -> None:
    stampede("put", "cli/json", "--max-age", "1h", stdin=b"\xff\x00")
    stampede("put", "cli/json", "text")
    rows = json.loads(stampede("get", "cli/json", "--all", "-o", "json").stdout)
    assert [row["length_bytes"] for row in rows] == [2, 4]
    assert (rows[0]["payload_base64"], rows[1]["payload"]) == ("/wA=", "text")
    lines = stampede("get", "cli/json", "--last", "1h", "-o", "jsonl").stdout.splitlines()
    assert [json.loads(line)["seq"] for line in lines] == [row["seq"] for row in rows]


def test_get_by_time_and_meta_time(stampede: Run) -> None:
    base = st.now() - 2_000_000_000
    for number in range(3):
        stampede("put", "cli/times", str(number), "--time", str(base + number * 10**8), "--max-age", "1h")
    assert (
        stampede("get", "cli/times", "newest-150ms", "newest", "--match", "start", "-o", "jsonl").stdout.count("\n")
        == 2
    )
    assert '"payload": "0"' in stampede("get", "cli/times", "--at", str(base + 5), "-o", "jsonl").stdout
    assert '"payload": "1"' in stampede("get", "cli/times", "--before", "newest", "-o", "jsonl").stdout
    assert stampede("get", "cli/times", "--all", "--raw").stdout == "012"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["0", "1", "--at", "newest"], "give two times or one of --last, --at, --before, --all, not both"),
        (["0", "1", "--before", "newest"], "give two times or one of --last, --at, --before, --all, not both"),
        (["0", "1", "--all"], "give two times or one of --last, --at, --before, --all, not both"),
        (["--at", "newest", "--match", "span"], "--match has no effect with --at"),
        (["--at", "newest", "--newest-first"], "--newest-first has no effect with --at"),
        (["--at", "newest", "--limit", "1"], "--limit has no effect with --at"),
        (["--before", "newest", "--bounds", "[]"], "--bounds has no effect with --before"),
    ],
)
def test_get_refuses_options_that_would_have_no_effect(stampede: Run, arguments: list[str], sentence: str) -> None:
    assert sentence in stampede("get", "cli/times", *arguments, status=2).stderr


@pytest.fixture(scope="module")
def thinned(cluster: LocalCluster, environment: dict[str, str]) -> tuple[str, int]:
    """A channel that got four short items, a second apart, and keeps two. Also the time of the first of the four."""
    time = st.now() - 8 * 10**9
    with st.connect(cluster.address, secret=cluster.secret_file.read_text().strip()) as rt:
        channel = rt.channel("cli/thinned", max_items=2)
        for number in range(4):
            channel.put(b"%d" % number, time=time + number * 10**9, duration="100ms")
        rt.channel("cli/empty")
    return "cli/thinned", time


@pytest.mark.parametrize(
    ("channel", "arguments", "sentence"),
    [
        ("cli/thinned", ["+0", "+1000"], "COLLECTED: max_items (2) has collected the items before 20"),
        ("cli/thinned", ["--before", "+0"], "COLLECTED: max_items (2) has collected the items before 20"),
        ("cli/thinned", ["+2500", "+2600"], "NEVER: the channel is past the interval, and no matching item was put"),
        ("cli/thinned", ["--bounds", "[)", "+2500", "+2500"], "NEVER: the interval is empty: it contains no instant"),
        ("cli/thinned", ["now+1h", "now+2h"], "NOT_YET: the newest item is at 20"),
        ("cli/empty", ["--last", "5s"], "NOT_YET: the channel holds no items; items up to 20"),
        ("cli/empty", [], "NOT_YET: the channel holds no items, so NEWEST and OLDEST have no time yet"),
    ],
)
def test_get_prints_a_sentence_with_the_reason_of_an_empty_answer(
    stampede: Run, thinned: tuple[str, int], channel: str, arguments: list[str], sentence: str
) -> None:
    """`+N` stands for N milliseconds after the first item that was put."""
    texts = [str(thinned[1] + int(one[1:]) * 10**6) if one.startswith("+") else one for one in arguments]
    done = stampede("get", channel, *texts, status=3)
    assert done.stdout == ""
    assert done.stderr.startswith(f"stampede: {sentence}")
    assert done.stderr.count("\n") == 1


def test_get_prints_a_sentence_with_the_reason_of_an_incomplete_answer(stampede: Run, thinned: tuple[str, int]) -> None:
    done = stampede("get", thinned[0], str(thinned[1]), "now", "-o", "jsonl")
    assert [json.loads(line)["payload"] for line in done.stdout.splitlines()] == ["2", "3"]
    assert done.stderr.startswith("stampede: COLLECTED: max_items (2) has collected")


def test_a_piped_line_of_text_is_shown_as_text(stampede: Run, process: Run) -> None:
    process("put", "cli/piped", stdin=b"text\n")
    assert stampede("get", "cli/piped").stdout.endswith("  text\\n\n")


def test_no_control_character_of_an_item_reaches_the_terminal(stampede: Run) -> None:
    stampede("put", "cli/hostile", "--attribute", "k=\x1b[2J", stdin=b"\x1b]0;t\x07\r\nforged")
    for form in ("table", "json"):
        text = stampede("get", "cli/hostile", "-o", form).stdout
        assert "forged" in text
        assert text.replace("\n", "").isprintable()


def test_raw_output_to_a_terminal_is_refused_if_it_has_control_characters(
    stampede: Run, environment: dict[str, str]
) -> None:
    stampede("put", "cli/raw", stdin=b"\x1b[2J")
    assert stampede("get", "cli/raw", "--raw").stdout == "\x1b[2J"
    ours, theirs = os.openpty()
    with os.fdopen(ours, "rb"):
        done = subprocess.run(
            [*COMMAND, "get", "cli/raw", "--raw"],
            env=environment,
            stdout=theirs,
            stderr=subprocess.PIPE,
            timeout=40,
            check=False,
        )
        os.close(theirs)
    assert done.returncode == 2
    assert b"write it to a file" in done.stderr


def test_a_time_without_a_zone_is_local_time(stampede: Run, process: Run) -> None:
    text = process("get", "cli/times/none", "2026-01-31T12:00:00", "now", status=1, TZ="Asia/Tokyo").stderr
    assert "there is no channel" in text
    stampede("put", "cli/zone", "x", "--max-age", "60s")
    put = process("put", "cli/zone", "y", "--time", "2026-01-31T12:00:00", TZ="Asia/Tokyo").stdout
    assert "at 2026-01-31T03:00:00" in put


@pytest.mark.parametrize(
    "words",
    ["ls", "supernode status", "supernode snapshot", "supernode init --data-dir s1 --listen 127.0.0.1:1", "certs init"],
)
def test_the_error_names_a_full_disk_below_the_output(
    stampede: Run, environment: dict[str, str], words: str, tmp_path: Path
) -> None:
    stampede("put", "cli/full", "x")
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [*COMMAND, *words.split()],
            env=environment | {"PYTHONUNBUFFERED": "1"},
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=40,
            check=False,
        )
    assert (done.returncode, done.stderr) == (1, "stampede: the output cannot be written: No space left on device\n")


def test_the_error_names_a_front_end_in_place_of_a_supernode_and_the_reverse(
    stampede: Run, cluster: LocalCluster
) -> None:
    [member] = json.loads(stampede("supernode", "status", "-o", "json").stdout)
    error_output = stampede("supernode", "status", "--member", cluster.address, status=1).stderr
    assert "no supernode answers there, but another service does; name a front-end with --url" in error_output
    error_output = stampede("supernode", "status", "--url", member["address"], status=1).stderr
    assert "no front-end answers there, but another service does; name a supernode with --member" in error_output


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["get", "--help"]])
def test_help_and_version_load_no_grpc(arguments: list[str]) -> None:
    script = (
        "import sys; from stampede_rt.cli.main import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "sys.exit(any(name.split('.')[0] in ('grpc', 'google') for name in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, timeout=40, check=False)
    assert done.returncode == 0, done


def test_ls_and_info_show_existing_channels(stampede: Run) -> None:
    stampede("put", "cli/shown/one", "x", "--max-items", "5")
    listed = stampede("ls", "cli/shown/*").stdout
    assert "cli/shown/one" in listed
    assert "5 items" in listed
    assert json.loads(stampede("ls", "cli/shown/*", "-o", "json").stdout)[0]["channel"] == "cli/shown/one"
    assert json.loads(stampede("ls", "cli/shown/*", "--long", "-o", "json").stdout)[0]["held"] == 1
    info = stampede("info", "cli/shown/one").stdout
    assert "accepted" in info
    assert stampede("ls", "no/such*").stdout == "no channel matches 'no/such*'\n"


def test_info_names_readers_and_writers_and_the_missed_items_of_a_slow_reader(
    stampede: Run, cluster: LocalCluster
) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("cli/used", max_items=100)
        with channel.subscribe(mode="newest") as items:
            for number in range(10):
                channel.put(b"%d" % number)
                next(items) if not number else None
            next(items)
            stats = channel.stats()
            facts = json.loads(stampede("info", "cli/used", "-o", "json").stdout)
            text = stampede("info", "cli/used").stdout
        assert channel.stats().writers == stats.writers
    [reader] = facts["readers"]
    assert (reader["collected"], reader["skipped"], facts["dropped"], stats.dropped) == (0, 8, 8, 8)
    caller = TESTER if judges_tests() else "@localhost"
    assert reader["subscriber"].startswith(f"{caller}#")
    assert [one["name"] for one in facts["writers"]] == [caller]
    assert facts["writers"][0]["last_put"] == stats.writers[0].last_put <= stats.host_time
    assert f"{reader['subscriber']} (8 skipped)" in text


def test_put_creates_a_channel_with_consumers_and_fails_if_it_stays_full(stampede: Run) -> None:
    options = ("--max-items", "1", "--on-full", "block", "--consumers", "2")
    stampede("put", "cli/consumed", "x", *options, "--max-age", "30s", "--max-age-unconsumed", "60s")
    facts = json.loads(stampede("info", "cli/consumed", "-o", "json").stdout)
    assert facts["on_full"] == "block"
    assert "2 consumers" in facts["keeps"]
    assert "0 of 2 taken" in stampede("info", "cli/consumed").stdout
    assert "full" in stampede("put", "cli/consumed", "y", "--timeout", "0.1", status=1).stderr


def test_echo_prints_new_items_until_it_is_interrupted(stampede: Run, following: Any) -> None:
    stampede("put", "cli/echo", "held")
    process = following("echo", "cli/echo", "--from", "oldest")
    assert "held" in process.stdout.readline()
    stampede("put", "cli/echo", "live")
    assert "live" in process.stdout.readline()
    interrupt(process)


def test_hz_and_bw_print_rates_until_they_are_interrupted(stampede: Run, following: Any) -> None:
    stampede("put", "cli/rates", "x")
    hz = following("hz", "cli/rates", "--every", "0.2")
    bw = following("bw", "cli/rates", "--every", "0.2")
    assert "items/s" in hz.stdout.readline()
    assert "in " in bw.stdout.readline()
    interrupt(hz)
    interrupt(bw)


def test_doctor_reports_a_healthy_cluster(stampede: Run) -> None:
    done = stampede("doctor")
    assert "Everything is well." in done.stdout
    assert "1 of 1 serve" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "status", "expected"),
    [
        (["get", "no/such/channel"], 1, "`stampede ls` lists"),
        (["put", "Wrong Name", "x"], 2, "not allowed; use"),
        (["put", "cli/wrong", "x", "--max-age", "3s"], 1, "cli/wrong"),
        (["get", "cli/wrong", "5", "3"], 2, "starts at"),
        (["get", "cli/wrong", "5"], 2, "two times"),
        (["get", "cli/wrong", "yesterday", "now"], 2, "is not a time"),
        (["get", "cli/wrong", "--last", "10"], 2, "ns, us, ms"),
        (["get", "cli/wrong", "--last=-5s"], 2, "leave the minus out"),
        (["put", "cli/wrong", "x", "--time", str(2**62)], 1, "ahead"),
        (["get", "cli/wrong", "--limit", "0"], 2, "1 or more"),
        (["ls", "--colour"], 2, "stampede ls --help"),
        (["put", "cli/wrong", "x", "y"], 2, "has no argument y"),
        (["fly"], 2, "fly"),
        ([], 2, "VERB"),
        (["ls", "--url", "localhost:1"], 1, "cannot connect to localhost:1"),
        (["ls", "--url", "localhost:x"], 2, "port from 1 to 65535"),
        (["hz", "cli/wrong", "--every", "0"], 2, "0.05 to 3600"),
    ],
)
def test_wrong_usage_is_answered_with_advice(stampede: Run, arguments: list[str], status: int, expected: str) -> None:
    stampede("put", "cli/wrong", "x", "--max-age", "60s")
    assert expected in stampede(*arguments, status=status).stderr


def test_standard_input_larger_than_one_item_is_refused(stampede: Run) -> None:
    assert "split it" in stampede("put", "cli/a", stdin=bytes(16 * 1024 * 1024 + 1), status=2).stderr


def test_the_error_of_a_wrong_secret_names_the_places_of_secrets(environment: dict[str, str], tmp_path: Any) -> None:
    wrong = tmp_path / "secret"
    wrong.write_text("wrong")
    wrong.chmod(0o600)
    done = subprocess.run(
        [*COMMAND, "ls"],
        env=environment | {"STAMPEDE_SECRET_FILE": str(wrong)},
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    assert done.returncode == 1
    assert "secret" in done.stderr
    assert "STAMPEDE_SECRET_FILE" in done.stderr


def test_help_lists_every_verb(stampede: Run) -> None:
    text = stampede("--help").stdout
    for verb in (
        "dev",
        "frontend",
        "supernode",
        "host",
        "demo",
        "ls",
        "info",
        "put",
        "get",
        "echo",
        "hz",
        "bw",
        "doctor",
    ):
        assert f" {verb} " in text


# To ask for the next response, gRPC takes the lock of the stream and then the lock of its connection. Here Ctrl-C comes
# after gRPC has taken the lock of the connection, and before the `with` block that would release this lock has begun.
# The exception then releases the lock of the stream, and not the lock of the connection. The thread that sends requests
# takes the lock of the stream, and waits for the lock of the connection. So `cancel`, which needs the first lock,
# would wait for ever. The test starts a thread in place of that one. `cancel` goes on only when it has the first lock.
ECHO_INTERRUPTED_WITHIN_A_LOCK = """
import os, signal, sys, threading

enter, held = threading.Condition.__enter__, threading.Event()
planted = []

def enter_and_interrupt(condition):
    caller = sys._getframe(1)
    if planted and caller.f_code.co_name == "cancel":
        held.wait()
    entered = enter(condition)
    if not planted and caller.f_code.co_name == "_next" and "grpc" in caller.f_code.co_filename:
        stream = caller.f_locals["self"]._state.condition
        if condition is not stream:
            planted.append(True)
            threading.Thread(target=send, args=(stream, condition), daemon=True).start()
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000):  # here the main thread's handler runs, if this is the main thread
                pass
    return entered

def send(stream, connection):
    enter(stream)
    held.set()
    enter(connection)
    connection.release()
    stream.release()

write = sys.stdout.write
def write_and_plant(text):
    threading.Condition.__enter__ = enter_and_interrupt
    return write(text)

sys.stdout.write = write_and_plant
from stampede_rt.cli.main import main
sys.exit(main(["echo", "cli/locked", "--from", "oldest"]))
"""


def test_an_interrupt_within_a_lock_of_grpcs_ends_the_command(stampede: Run, environment: dict[str, str]) -> None:
    stampede("put", "cli/locked", "an item")
    over_grpc = environment | {"STAMPEDE_TRANSPORT": "grpc", "STAMPEDE_GRPC_STREAMS": "public"}
    with started([sys.executable, "-c", ECHO_INTERRUPTED_WITHIN_A_LOCK], env=over_grpc) as process:
        out, _ = process.communicate(timeout=20)
    assert (process.returncode, out.count("an item")) == (130, 1)


def test_a_payload_that_is_not_text_is_put_as_bytes(stampede: Run) -> None:
    stampede("put", "cli/bytes", os.fsdecode(b"\xff"), "--max-age", "1h")
    assert json.loads(stampede("get", "cli/bytes", "-o", "jsonl").stdout)["payload_base64"] == "/w=="


@pytest.mark.parametrize("closing", [">&-", "<&-", "2>&-"])
def test_a_closed_standard_stream_is_not_reported_as_a_defect(environment: dict[str, str], closing: str) -> None:
    command = f"{sys.executable} -m stampede_rt.cli ls {closing}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, timeout=40, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
