"""The log's thread wakes up without delay. After a failure it ends, and by default the process ends, too."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from stampede_rt_supernode.replication.threads import tick_thread
from stampede_rt_supernode.replication.threads.tick_thread import EXIT_CODE, EXIT_DISK, TickThread


class SteppedReplica:
    """Stands for a replica."""

    def __init__(self, *, fail: BaseException | None = None) -> None:
        self.stepped = threading.Semaphore(0)
        self.closed = threading.Event()
        self.fail = fail
        self.pause = 60.0

    def step(self) -> bool:
        if self.fail is not None:
            raise self.fail
        self.stepped.release()
        return False

    def pause_seconds(self) -> float:
        return self.pause

    def close(self) -> None:
        self.closed.set()


def start(replica: Any, *, tick_seconds: float) -> tuple[TickThread, list[BaseException], threading.Event]:
    failures: list[BaseException] = []
    failed = threading.Event()

    def on_fatal(error: BaseException) -> None:
        failures.append(error)
        failed.set()

    replica.pause = tick_seconds
    thread = TickThread(on_fatal=on_fatal)
    thread.start(replica)
    return thread, failures, failed


def test_a_wake_up_performs_a_step_before_the_next_tick() -> None:
    replica = SteppedReplica()
    thread, _, _ = start(replica, tick_seconds=60.0)
    assert replica.stepped.acquire(timeout=5)
    thread.wake()
    assert replica.stepped.acquire(timeout=5)
    thread.stop()
    assert replica.closed.is_set()


def test_the_thread_ticks_at_regular_intervals() -> None:
    replica = SteppedReplica()
    thread, _, _ = start(replica, tick_seconds=0.001)
    assert all(replica.stepped.acquire(timeout=5) for _ in range(5))
    thread.stop()


def test_a_failure_is_reported_and_ends_the_ticking() -> None:
    replica = SteppedReplica(fail=OSError("the disk is full"))
    thread, failures, failed = start(replica, tick_seconds=0.001)
    assert failed.wait(5)
    thread.stop()
    assert [str(error) for error in failures] == ["the disk is full"]
    assert not replica.closed.is_set()


def test_by_default_a_failure_ends_the_process_with_its_reason() -> None:
    script = (
        "from stampede_rt_supernode.replication.threads.tick_thread import end_process\n"
        "end_process(OSError('the disk is full'))\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=False)
    assert ended.returncode == EXIT_CODE
    assert "the replicated log failed and the process ends: OSError('the disk is full')" in ended.stderr


def test_the_text_of_a_failure_cannot_forge_a_log_line() -> None:
    script = (
        "from stampede_rt_runtime.logs import set_up_logging\n"
        "from stampede_rt_supernode.replication.threads.tick_thread import end_process\n"
        "set_up_logging('info')\n"
        "end_process(ValueError('a\\r\\nforged\\x1b[2J'))\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, timeout=30, check=False)
    line, sentence, rest = ended.stderr.decode().split("\n")
    assert (line.isprintable(), sentence.isprintable(), rest) == (True, True, "")
    assert "event=replicated_log_failed" in line


def test_a_full_disk_ends_the_process_with_a_sentence_and_no_traceback() -> None:
    script = (
        "import sqlite3\n"
        "from stampede_rt_supernode.replication.threads.tick_thread import end_process\n"
        "end_process(sqlite3.OperationalError('database or disk is full'))\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30, check=False)
    assert (ended.returncode, ended.stderr.count("\n")) == (EXIT_DISK, 1)
    assert "its data folder cannot be written (database or disk is full)" in ended.stderr
    assert "nothing that was acknowledged is lost" in ended.stderr


class HangingReplica(SteppedReplica):
    """A replica whose disk hangs until it is let go."""

    def __init__(self) -> None:
        super().__init__()
        self.may_continue = threading.Event()

    def step(self) -> bool:
        self.stepped.release()
        self.may_continue.wait()
        return False


def test_a_step_that_hangs_is_logged_once_and_its_end_too(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(tick_thread, "STUCK_SECONDS", 0.05)
    monkeypatch.setattr(tick_thread, "LOOK_SECONDS", 0.01)
    replica = HangingReplica()
    thread, failures, _ = start(replica, tick_seconds=0.01)
    try:
        wait_for(lambda: len(caplog.records) == 1)
        assert thread.stuck_seconds() > 0.0
    finally:
        replica.may_continue.set()
    wait_for(lambda: len(caplog.records) == 2)
    assert ["has not answered" in record.getMessage() for record in caplog.records] == [True, False]
    assert thread.stuck_seconds() == 0.0
    thread.stop()
    assert not failures


def wait_for(condition: Callable[[], bool]) -> None:
    while not condition():
        threading.Event().wait(0.005)


def test_a_process_that_was_suspended_does_not_report_a_slow_disk(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    looks = threading.Semaphore(0)

    class Ended(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            looks.release()
            return super().wait(0.001)

    thread = TickThread(on_fatal=lambda error: None)
    monkeypatch.setattr(thread, "_ended", Ended())
    # A look counts as so short a time that the looks never add up to STUCK_SECONDS. By the clock, the step has lasted
    # for two days at the first look.
    monkeypatch.setattr(tick_thread, "LOOK_SECONDS", 1e-9)
    thread._step_began = time.monotonic() - 2 * 86400.0
    watcher = threading.Thread(target=thread._watch, daemon=True)
    watcher.start()
    assert all(looks.acquire(timeout=5) for _ in range(5))
    thread._ended.set()
    watcher.join()
    assert caplog.records == []
