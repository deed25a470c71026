"""Runs a role in its process: settings, the start by the orchestrator, reports, and the end.

A role never lives longer than the orchestrator. Its standard input is a pipe from the orchestrator. When the
orchestrator ends in any way, the kernel closes the pipe, and the role ends immediately. Only the orchestrator handles
Ctrl-C.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging import messages
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND

SECONDS_MIN = 2
SECONDS_MAX = 600
EXIT_ORPHANED = 3
PROGRESS_NANOS = 500_000_000
_START_LINE_BYTES_MAX = 256


@dataclass(frozen=True, kw_only=True, slots=True)
class RoleSettings:
    """The settings of every role: the address of the cluster, and the length of the programme in whole seconds."""

    address: str
    seconds: int

    def __post_init__(self) -> None:
        if not SECONDS_MIN <= self.seconds <= SECONDS_MAX:
            raise ValueError(
                f"--seconds is {self.seconds}; the programme runs for {SECONDS_MIN} to {SECONDS_MAX} whole seconds"
            )

    @property
    def length_nanos(self) -> int:
        """The programme's length."""
        return self.seconds * NANOS_PER_SECOND


class Stage:
    """A role's connection to the orchestrator. Several threads may call its methods, except `wait_for_start`."""

    def __init__(self, settings: RoleSettings) -> None:
        self.settings = settings
        self._lock = threading.Lock()
        self._progress_nanos = 0  # when the last `progress` event was sent
        self._ready_cpu_seconds = 0.0

    def wait_for_start(self) -> int:
        """Report that the role is ready, and wait for the message with the start of the programme.

        Returns the start, in nanoseconds since the epoch. Call this method once, after all slow preparations. If the
        orchestrator ends then or later, this process ends, too.
        """
        self.send_event("ready")
        with open(0, "rb", buffering=0, closefd=False) as orchestrator:
            line = orchestrator.readline(_START_LINE_BYTES_MAX)
        if not line:
            os._exit(EXIT_ORPHANED)
        self._ready_cpu_seconds = time.process_time()
        threading.Thread(target=_end_with_orchestrator, name="orchestrator watch", daemon=True).start()
        return messages.decode_start(line.decode())

    @property
    def cpu_seconds(self) -> float:
        """Return the CPU time of this process since the start of the programme, without its preparations."""
        return time.process_time() - self._ready_cpu_seconds

    def send_event(self, event: str, **fields: object) -> None:
        """Send one event. Blocks while the orchestrator does not read."""
        line = messages.encode(event, **fields)
        with self._lock:
            print(line, flush=True)

    def send_progress(self, **fields: object) -> None:
        """Send a `progress` event, or nothing if the last one is less than PROGRESS_NANOS ago."""
        now = time.monotonic_ns()
        with self._lock:
            if now - self._progress_nanos < PROGRESS_NANOS:
                return
            self._progress_nanos = now
        self.send_event("progress", **fields)


def run_role(play: Callable[[Stage], Mapping[str, object]], argv: Sequence[str] | None = None) -> int:
    """Run a role and report its result. Returns the exit status, 1 after a reported failure.

    Any other exception is a defect of this demo. Its traceback goes to standard error, which the orchestrator quotes.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stage = Stage(_parse(argv))
    try:
        result = play(stage)
    except (DemoFailed, st.StampedeError) as failure:
        stage.send_event("failed", message=str(failure))
        return 1
    stage.send_event("result", cpu_seconds=stage.cpu_seconds, cpu_seconds_in_all=time.process_time(), **result)
    return 0


def _parse(argv: Sequence[str] | None) -> RoleSettings:
    parser = argparse.ArgumentParser(description="One role of a demo; the orchestrator starts it.")
    parser.add_argument("--address", required=True, help="the address of the cluster's front-end")
    parser.add_argument("--seconds", required=True, type=int, help="the length of the programme")
    found = parser.parse_args(sys.argv[1:] if argv is None else argv)
    return RoleSettings(address=found.address, seconds=found.seconds)


def _end_with_orchestrator() -> None:
    while os.read(0, 4096):
        # The orchestrator writes nothing more; the read returns nothing when the other end is closed.
        pass
    os._exit(EXIT_ORPHANED)
