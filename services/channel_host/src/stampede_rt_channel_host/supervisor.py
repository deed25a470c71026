"""Runs several host processes on one machine: `stampede host --processes N` (decision 0161).

The supervisor holds no channels. It starts the processes, starts an ended process again, and ends all processes when it
gets a stop signal. Each process reads a pipe of which only the supervisor has the other end. So the processes end even
if the supervisor is killed.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import Iterator, Sequence

from stampede_rt.escaping import escaped
from stampede_rt_runtime.main import EXIT_FAILED
from stampede_rt_runtime.supervision.systemd import READY, STOPPING, notify_systemd, without_supervisor

logger = logging.getLogger(__name__)

STOP_SECONDS_MAX = 6.0  # longer than a host waits for its calls (2 * 2 s), after it has given its channels away
PAUSE_SECONDS_MIN, PAUSE_SECONDS_MAX = 0.5, 30.0
STEADY_SECONDS = 60.0  # a process that ran for this time starts again after the shortest pause
_STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)


class RestartPauses:
    """The pauses before the next start of a process. Each pause is twice as long as the one before it."""

    def __init__(self) -> None:
        self._next_s = PAUSE_SECONDS_MIN

    def after(self, ran_s: float) -> float:
        """The pause in seconds after a run of `ran_s` seconds."""
        if ran_s >= STEADY_SECONDS:
            self._next_s = PAUSE_SECONDS_MIN
        pause_s, self._next_s = self._next_s, min(2 * self._next_s, PAUSE_SECONDS_MAX)
        return pause_s


class Supervisor:
    """The processes of one machine, each with its own arguments. Use it on one event loop."""

    def __init__(self, arguments: Sequence[Sequence[str]], drain_seconds: float) -> None:
        """`drain_seconds`: how long each process may take to give its channels away. STOP_SECONDS_MAX later the
        supervisor kills a process that still runs.
        """
        self._arguments = arguments
        self.stop_seconds_max = drain_seconds + STOP_SECONDS_MAX
        self._running: dict[int, Process] = {}  # by the number of the process
        self._ready: frozenset[int] = frozenset()  # the processes that were ever ready
        self._stopping = asyncio.Event()
        self._exit_code = 0

    async def run(self) -> int:
        """Keep the processes running until a stop signal. Returns the exit status.

        If a process refuses to start, and was never ready before, all processes end. The status is then the exit status
        of this process.
        """
        with self._stop_signals():
            keeping = [asyncio.create_task(self._keep(number)) for number in range(len(self._arguments))]
            try:
                await self._stopping.wait()
                await asyncio.wait(keeping, timeout=self.stop_seconds_max)
            finally:
                self._stopping.set()
                self._kill_the_rest()
                await asyncio.gather(*keeping)
        return self._exit_code

    async def _keep(self, number: int) -> None:
        """Start one process, and start it again each time it ends, until the stop."""
        pauses = RestartPauses()
        was_ready = False
        try:
            while not self._stopping.is_set():  # paced by the pauses
                started_s = time.monotonic()
                status, is_ready = await self._run_once(number)
                was_ready = was_ready or is_ready
                if self._stopping.is_set() or (status > 0 and not was_ready):
                    self._end(status)
                    return
                await self._pause(number, status, pauses.after(time.monotonic() - started_s))
        except BaseException:
            self._end(EXIT_FAILED)  # a defect of one task ends the whole service
            raise

    async def _run_once(self, number: int) -> tuple[int, bool]:
        """Run the process to its end. Returns its exit status, and whether it was ready."""
        try:
            process = await self._start(number)
        except OSError as error:  # such as a lack of memory or of process ids
            logger.warning(
                "a host process cannot start",
                extra={"event": "host_process_start_failed", "number": number, "why": str(error)},
            )
            return EXIT_FAILED, False
        was_ready = await self._pass_on_lines(number, process)
        status = await process.wait()
        del self._running[number]
        return status, was_ready

    async def _start(self, number: int) -> Process:
        # -P: Python must not import modules of the user's present folder instead of ours.
        watched = [sys.executable, "-P", "-m", "stampede_rt_runtime.parent_watch", "stampede_rt_channel_host"]
        process = self._running[number] = await asyncio.create_subprocess_exec(
            *watched,
            *self._arguments[number],
            stdin=PIPE,  # `parent_watch` reads it
            stdout=PIPE,
            start_new_session=True,  # only the supervisor gets Ctrl-C of the terminal
            env=without_supervisor(),
        )
        logger.info(
            "started a host process", extra={"event": "host_process_started", "number": number, "pid": process.pid}
        )
        if self._stopping.is_set():  # the stop came during the start
            _signal(process, signal.SIGTERM)
        return process

    async def _pass_on_lines(self, number: int, process: Process) -> bool:
        """Print the lines that the process prints on stdout, until it ends. Returns whether there were any.

        A host prints only its ready line. The service is ready when each process has printed a line.
        """
        assert process.stdout is not None
        was_ready = False
        while line := await process.stdout.readline():
            was_ready = True
            self._note_ready(number)
            with contextlib.suppress(OSError):  # a closed pipe: the hosts still serve
                sys.stdout.write(escaped(line.decode(errors="replace").rstrip("\n")) + "\n")
                sys.stdout.flush()
        return was_ready

    def _note_ready(self, number: int) -> None:
        before, self._ready = self._ready, self._ready | {number}
        if len(before) < len(self._ready) == len(self._arguments):
            notify_systemd(READY)

    async def _pause(self, number: int, status: int, pause_s: float) -> None:
        logger.warning(
            "a host process has ended; it is started again after a pause",
            extra={"event": "host_process_ended", "number": number, "exit_status": status, "pause_s": pause_s},
        )
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(pause_s):
                await self._stopping.wait()

    def _end(self, status: int) -> None:
        """End all processes. The first status other than 0 becomes the exit status."""
        if status < 0:  # the number of the signal that ended the process; SIGTERM may come before the host handles it
            status = 0 if status == -signal.SIGTERM else EXIT_FAILED
        self._exit_code = self._exit_code or status
        if not self._stopping.is_set():
            self._ask_to_stop()

    def _ask_to_stop(self) -> None:
        """Tell each process to stop. A second call tells them to end all calls immediately."""
        self._stopping.set()
        notify_systemd(STOPPING)
        for process in self._running.values():
            _signal(process, signal.SIGTERM)
            _signal(process, signal.SIGCONT)  # a frozen process gets no other signal

    def _kill_the_rest(self) -> None:
        for number, process in self._running.items():
            logger.warning(
                "a host process did not end in time; it is killed",
                extra={"event": "host_process_killed", "number": number},
            )
            _signal(process, signal.SIGKILL)

    @contextlib.contextmanager
    def _stop_signals(self) -> Iterator[None]:
        loop = asyncio.get_running_loop()
        for number in _STOP_SIGNALS:
            loop.add_signal_handler(number, self._ask_to_stop)
        try:
            yield
        finally:
            for number in _STOP_SIGNALS:
                loop.remove_signal_handler(number)


def _signal(process: Process, number: signal.Signals) -> None:
    """Send a signal. Does nothing if the process has ended."""
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(number)
