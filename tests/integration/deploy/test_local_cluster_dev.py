"""`stampede dev` as a user runs it: its own process, its screen, its exit codes, and the processes that are left."""

from __future__ import annotations

import os
import re
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import pytest

import stampede_rt as st
from stampede_rt.cli.interrupts import INTERRUPTED
from stampede_rt_local.dev import main
from stampede_rt_local.kept_directory import members_in
from stampede_rt_local.settings import DevSettings

READY_SECONDS = 30  # long, because the machine may be busy
DEV = [sys.executable, "-m", "stampede_rt_local"]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return tmp_path


class Dev:
    """A running `stampede dev`. `screen` is its output until it was ready, `children` its services."""

    def __init__(self, process: subprocess.Popen[str], screen: str) -> None:
        self.process = process
        self.screen = screen
        self.children = {pid: os.pidfd_open(pid) for pid in children_of(process.pid)}

    def ended(self, pid: int) -> bool:
        """Wait for the end of a child, READY_SECONDS at most. A pidfd is readable when its process has ended."""
        readable, _, _ = select.select([self.children[pid]], [], [], READY_SECONDS)
        return bool(readable)

    def all_ended(self) -> bool:
        return all(self.ended(pid) for pid in self.children)

    def child(self, word: str) -> int:
        return next(pid for pid in self.children if word in command_of(pid))


def children_of(parent: int) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and parent_of(int(entry.name)) == parent:
            found.append(int(entry.name))
    return found


def parent_of(pid: int) -> int:
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:  # the process ended while the test looked
        return 0
    match = re.search(r"^PPid:\s+(\d+)", status, re.MULTILINE)
    return int(match[1]) if match else 0


def command_of(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_text()


@contextmanager
def running(*arguments: str) -> Iterator[Dev]:
    command = [*DEV, "--listen", "localhost:0", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    with process.stdout, process.stderr:
        dev = None
        try:
            screen = ""
            while "Ctrl-C stops it." not in screen and (line := process.stdout.readline()):
                screen += line
            dev = Dev(process, screen)
            yield dev
        finally:
            process.kill()
            process.wait()
            for handle in () if dev is None else dev.children.values():
                os.close(handle)


def address_of(dev: Dev) -> str:
    match = re.match(r"Stampede RT is ready at (localhost:\d+) ", dev.screen)
    assert match is not None, dev.screen
    return match[1]


def test_the_screen_shows_the_address_and_the_next_command(home: Path) -> None:
    with running() as dev:
        match = re.match(r"Stampede RT is ready at (localhost:\d+) \(1 supernode, 1 host, 1 front-end; ", dev.screen)
        assert match is not None, dev.screen + dev.process.stderr.read()
        host, port = match[1].split(":")
        assert f'st.connect("{match[1]}")' in dev.screen
        assert f"export STAMPEDE_URL={match[1]}" in dev.screen
        assert str(home / "stampede" / "secret") in dev.screen
        assert "stampede put cam/left" in dev.screen
        assert "Everything is held in memory." in dev.screen
        socket.create_connection((host, int(port)), timeout=10).close()


def test_stampede_dev_runs_the_requested_number_of_hosts_and_supernodes(home: Path) -> None:
    with running("--hosts", "2", "--supernodes", "3", "--archive", str(home / "kept")) as dev:
        assert "(3 supernodes, 2 hosts, 1 front-end; " in dev.screen
        assert (
            f"Archives of channels are in {home / 'kept'}. The names of channels, groups and queues are on disk, too; "
            "everything else is held in memory." in dev.screen
        )
        assert len(dev.children) == 6


def test_the_next_start_with_the_same_archive_has_the_recorded_items_again(home: Path) -> None:
    words = ("--archive", str(home / "kept"))
    with running(*words) as dev, st.connect(address_of(dev)) as rt:
        channel = rt.channel("kept", archive="7d")
        for number in range(10):
            channel.put(b"%d" % number)
        dev.process.send_signal(signal.SIGTERM)
        dev.process.communicate(timeout=READY_SECONDS)
    with running(*words) as dev, st.connect(address_of(dev)) as rt:
        found = rt.channel("kept", create=False).get(st.OLDEST, st.NEWEST)
        assert ([item.seq for item in found], found.reason) == ([*range(1, 11)], None)


@pytest.mark.parametrize("form", ["text", "json"])
def test_the_screen_shows_the_faults_of_archives_that_hosts_log_during_the_start(
    home: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    for name, value in (("ENDPOINT_URL", "http://127.0.0.1:1"), ("REGION", "x"), ("ALLOW_HTTP", "true")):
        monkeypatch.setenv(f"AWS_{name}", value)
    for name in ("ACCESS_KEY_ID", "SECRET_ACCESS_KEY"):
        monkeypatch.setenv(f"AWS_{name}", "of-tests")
    words = ("--archive", "s3://away/x", "--archive-folder", str(home / "kept"), "--log-format", form)
    with running(*words) as dev:
        dev.process.send_signal(signal.SIGTERM)
        _, error_output = dev.process.communicate(timeout=READY_SECONDS)
    assert "the object store of the archive cannot be reached; the host tries again" in error_output


def test_each_object_store_has_a_directory_of_its_own(home: Path) -> None:
    one, other, repeated = (
        DevSettings(archive=f"s3://{bucket}/a", archive_folder=home).directory for bucket in ("one", "other", "one")
    )
    assert one == repeated != other
    assert one is not None
    assert other is not None
    assert one.parent == other.parent == home


def test_another_number_of_supernodes_than_in_the_folder_is_refused(
    home: Path, complaint: Callable[..., tuple[int, str]]
) -> None:
    members_in(home / "kept" / "directory", 1, "localhost")
    code, error_output = complaint("--listen", "localhost:0", "--archive", str(home / "kept"), "--supernodes", "3")
    assert (code, error_output.count("\n")) == (1, 1)
    assert "has a directory for --supernodes 1 at localhost; start with --supernodes 1" in error_output


def test_fewer_hosts_than_the_folder_has_archives_of_are_refused(
    home: Path, complaint: Callable[..., tuple[int, str]]
) -> None:
    (home / "kept" / "h2").mkdir(parents=True)
    code, error_output = complaint("--listen", "localhost:0", "--archive", str(home / "kept"))
    assert (code, error_output.count("\n")) == (1, 1)
    assert "has archives of more hosts than 1; start with --hosts as before" in error_output


def test_the_last_lines_of_a_service_that_does_not_start_are_lines(
    home: Path, complaint: Callable[..., tuple[int, str]]
) -> None:
    (home / "kept").write_bytes(b"")
    code, error_output = complaint("--listen", "localhost:0", "--archive", str(home / "kept"))
    assert code == 1
    assert "\\n" not in error_output


def test_stampede_dev_with_web_serves_the_page_and_ends_it(home: Path) -> None:
    with running("--web", "--web-listen", "localhost:0") as dev:
        match = re.search(r"See all streams on one time line: (http://localhost:\d+/)", dev.screen)
        assert match is not None, dev.screen
        with urlopen(f"{match[1]}api/overview", timeout=READY_SECONDS) as answer:
            assert b'"supernodes"' in answer.read()
        dev.process.send_signal(signal.SIGINT)
        dev.process.communicate(timeout=READY_SECONDS)
        assert dev.all_ended()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_stop_ends_stampede_dev_with_code_0(home: Path, number: signal.Signals) -> None:
    with running() as dev:
        dev.process.send_signal(number)
        out, err = dev.process.communicate(timeout=READY_SECONDS)
        assert (dev.process.returncode, err) == (0, "")
        assert "nothing is left running" in out
        assert dev.all_ended()


def test_a_second_ctrl_c_ends_stampede_dev_immediately_and_no_process_remains(home: Path) -> None:
    with running() as dev:
        while dev.process.poll() is None:  # the system may deliver two signals as one
            dev.process.send_signal(signal.SIGINT)
        _, err = dev.process.communicate(timeout=READY_SECONDS)
        assert (dev.process.returncode, err) == (INTERRUPTED, "")
        assert dev.all_ended()


def test_no_process_remains_after_stampede_dev_was_killed(home: Path) -> None:
    with running() as dev:
        assert len(dev.children) == 3
        dev.process.kill()
        assert dev.all_ended()


def test_stampede_dev_stops_with_code_1_when_a_service_dies(home: Path) -> None:
    with running() as dev:
        os.kill(dev.child("stampede_rt_channel_host"), signal.SIGKILL)
        _, err = dev.process.communicate(timeout=READY_SECONDS)
        assert dev.process.returncode == 1
        assert "host h1 ended with exit code -9" in err
        assert dev.all_ended()


def test_stampede_dev_stops_when_its_last_host_dies(home: Path) -> None:
    with running("--hosts", "2") as dev:
        one, two = (pid for pid in dev.children if "stampede_rt_channel_host" in command_of(pid))
        os.kill(one, signal.SIGKILL)
        assert dev.process.stderr is not None
        output = ""
        while "the others go on" not in output:
            line = dev.process.stderr.readline()
            assert line, output
            output += line
        assert "ended with exit code -9" in output
        assert dev.process.poll() is None
        os.kill(two, signal.SIGKILL)
        _, err = dev.process.communicate(timeout=READY_SECONDS)
        assert dev.process.returncode == 1
        assert "everything else was stopped" in err
        assert dev.all_ended()


@pytest.fixture
def complaint(home: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    def complaint_of(*arguments: str) -> tuple[int, str]:
        code = main(arguments)
        output = capsys.readouterr()
        assert output.out == ""
        return code, output.err

    return complaint_of


def test_stampede_dev_reports_a_port_in_use_in_one_line_and_ends_with_code_1(
    complaint: Callable[..., tuple[int, str]],
) -> None:
    with socket.create_server(("localhost", 0)) as holder:
        port = holder.getsockname()[1]
        code, error_output = complaint("--listen", f"localhost:{port}")
    assert code == 1
    assert error_output == (
        f"stampede dev: localhost:{port} is in use by another process; stop that one, or choose another port with "
        "--listen\n"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--host", "2"), "there is no flag --host; did you mean --hosts?"),
        (("--hosts", "0"), "--hosts: '0' cannot be used; allowed: 1 to 16"),
        (("--supernodes", "many"), "--supernodes: 'many' cannot be used; allowed: a whole number"),
        (("--listen", "192.0.2.1:1"), "--allow-insecure-anywhere"),
        (("--listen", "0.0.0.0:1", "--allow-insecure-anywhere"), "name one address of this machine"),
    ],
)
def test_stampede_dev_reports_a_bad_flag_in_one_line_and_ends_with_code_2(
    complaint: Callable[..., tuple[int, str]], arguments: tuple[str, ...], message: str
) -> None:
    code, error_output = complaint(*arguments)
    assert code == 2
    assert message in error_output
    assert error_output.count("\n") == 1


def test_a_secret_that_others_can_read_is_refused(home: Path, complaint: Callable[..., tuple[int, str]]) -> None:
    place = home / "secret"
    place.write_text("known to all")
    place.chmod(0o644)
    code, error_output = complaint("--listen", "localhost:0", "--secret-file", str(place))
    assert code == 1
    assert error_output == f"stampede dev: the secret file {place} can be read by every user; run: chmod 600 {place}\n"
