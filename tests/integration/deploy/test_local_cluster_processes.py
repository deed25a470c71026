"""Child processes of `stampede dev` and of the tests: readiness, failures and stopping. No process is left over."""

from __future__ import annotations

import os
import queue
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from subprocess import PIPE

import pytest

from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_local.ports import BLOCK_PORTS, PORTS, PortBlocks, free_ports
from stampede_rt_local.process import LAST_LINES_MAX, STOP_SECONDS, ServiceFailed, ServiceProcess
from stampede_rt_runtime import parent_watch
from stampede_rt_runtime.server import DRAIN_SECONDS
from tests.support.processes import started

READY_SECONDS = 20


@pytest.fixture(autouse=True)
def _services_find_the_fake_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[3]))


@pytest.fixture
def ends() -> queue.SimpleQueue[ServiceProcess]:
    return queue.SimpleQueue()


@pytest.fixture
def make(ends: queue.SimpleQueue[ServiceProcess]) -> Iterator[object]:
    made: list[ServiceProcess] = []

    def service(*arguments: str, **limits: float) -> ServiceProcess:
        made.append(ServiceProcess("fake", "tests.support.fake_service", arguments, on_exit=ends.put, **limits))
        made[-1].start()
        return made[-1]

    yield service
    for one in made:
        one.kill()


def test_a_ready_service_has_the_address_that_it_announced(make) -> None:
    service = make("good")
    assert service.wait_ready(READY_SECONDS) == service.address == f"localhost:{service.pid}"
    assert service.alive


def test_a_service_that_ends_before_it_is_ready_is_reported_with_its_output(make) -> None:
    service = make("fails")
    with pytest.raises(ServiceFailed, match=r"(?s)ended with exit code 3 before it was ready.*it cannot be"):
        service.wait_ready(READY_SECONDS)
    assert not service.alive


def test_a_service_that_is_not_ready_in_time_is_reported(make) -> None:
    with pytest.raises(ServiceFailed, match=r"fake is not ready after 0\.3 s"):
        make("never-ready").wait_ready(0.3)


def test_stopping_is_in_order(make, ends: queue.SimpleQueue[ServiceProcess]) -> None:
    service = make("good")
    service.wait_ready(READY_SECONDS)
    service.stop()
    assert service.exit_code == -signal.SIGTERM
    assert ends.get(timeout=READY_SECONDS) is service


def test_a_service_that_does_not_stop_is_killed_after_the_bound(make) -> None:
    service = make("stubborn", stop_seconds=0.2)
    service.wait_ready(READY_SECONDS)
    service.stop()
    assert service.exit_code == -signal.SIGKILL


def test_a_host_may_move_its_channels_away_and_wait_for_its_calls_before_it_is_killed() -> None:
    assert HostSettings(frontend=["localhost:1"]).drain_seconds + 2 * DRAIN_SECONDS < STOP_SECONDS


def test_a_killed_service_is_reported_and_can_be_started_again(make, ends: queue.SimpleQueue[ServiceProcess]) -> None:
    service = make("good")
    first = service.wait_ready(READY_SECONDS)
    service.kill()
    assert ends.get(timeout=READY_SECONDS) is service
    assert service.exit_code == -signal.SIGKILL
    assert service.restart() != first
    assert service.alive


def test_a_paused_service_can_be_resumed_and_stopped(make) -> None:
    service = make("good")
    service.wait_ready(READY_SECONDS)
    service.pause()
    os.waitid(os.P_PID, service.pid, os.WSTOPPED | os.WNOWAIT)
    service.resume()
    os.waitid(os.P_PID, service.pid, os.WCONTINUED | os.WNOWAIT)
    service.pause()
    service.stop()
    assert service.exit_code == -signal.SIGTERM


def test_only_the_last_lines_of_a_chatty_service_are_kept(make) -> None:
    service = make("chatty")
    service.wait_ready(READY_SECONDS)
    assert len(service.last_lines) == LAST_LINES_MAX


def test_a_service_does_not_inherit_stampede_variables(make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STAMPEDE_LISTEN", "elsewhere:1")
    service = make("environment", "--flag")
    service.wait_ready(READY_SECONDS)
    assert "environment [] ['--flag']" in service.last_lines


def test_a_module_in_the_users_folder_does_not_stand_in_for_a_services(
    make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "threading.py").write_text("raise SystemExit('the wrong one')")
    monkeypatch.chdir(tmp_path)
    assert make("good").wait_ready(READY_SECONDS)


def test_a_service_cannot_be_started_twice(make) -> None:
    service = make("good")
    with pytest.raises(ServiceFailed, match="is running already"):
        service.start()


def test_no_service_outlives_a_parent_that_was_killed() -> None:
    with started([sys.executable, "-m", "tests.support.parent_of_services"]) as parent:
        assert parent.stdout is not None
        handles = [os.pidfd_open(int(pid)) for pid in parent.stdout.readline().split()]
        assert len(handles) == 2
        parent.kill()
        parent.wait(READY_SECONDS)
        for handle in handles:  # readable when the process has ended
            readable, _, _ = select.select([handle], [], [], parent_watch.GRACE_SECONDS + READY_SECONDS)
            os.close(handle)
            assert readable


def test_free_ports_are_different_and_can_be_listened_at() -> None:
    ports = free_ports(8, excluded=20_000)
    assert len(set(ports)) == 8
    assert 20_000 not in ports
    for port in ports:
        socket.create_server(("localhost", port)).close()


def test_two_processes_never_choose_the_same_free_port(tmp_path: Path) -> None:
    """In an earlier version, each process took random free ports.

    One test run then got the port of a restarting service of another test run.
    """
    path = tmp_path / "ports"
    script = (
        "import sys; from pathlib import Path; from itertools import islice\n"
        "from stampede_rt_local.ports import PortBlocks\n"
        "print(*islice(PortBlocks(Path(sys.argv[1])).ports(), int(sys.argv[2])), flush=True); sys.stdin.read()"
    )
    with ExitStack() as ends:
        taken: list[str] = []
        for _ in range(3):
            command = [sys.executable, "-c", script, str(path), str(2 * BLOCK_PORTS)]
            process = ends.enter_context(subprocess.Popen(command, stdin=PIPE, stdout=PIPE, text=True))
            assert process.stdin is not None
            assert process.stdout is not None
            ends.callback(process.stdin.close)
            taken += process.stdout.readline().split()
        assert len(set(taken)) == len(taken) == 6 * BLOCK_PORTS
        everything = [*PortBlocks(path).ports()]
        assert not set(everything) & set(map(int, taken))
        assert len(everything) == len(PORTS) - len(taken)
    assert len([*PortBlocks(path).ports()]) == len(PORTS), "the ports are free again when their processes have ended"


def test_a_port_is_taken_again_as_late_as_possible() -> None:
    first = free_ports(1)[0]
    assert first not in free_ports(BLOCK_PORTS // 2)
