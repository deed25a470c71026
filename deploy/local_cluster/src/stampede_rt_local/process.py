"""One service as a child process: starts it, waits for it, watches it, stops it, and keeps its last lines."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import IO, ClassVar

from stampede_rt_local.namespaces import NetworkNamespace

LAST_LINES_MAX = 50
LINE_CHARS_MAX = 4096
LOOK_SECONDS = 0.25
STOP_SECONDS = 11.0  # a host moves its channels away for 5 s, and a service waits for calls for 2 * 2 s
_READY = re.compile(r"stampede \S+(?: \S+)? ready on (\S+)\s*")


class ServiceFailed(Exception):
    """A service could not start, or ended by itself; the text has its last lines."""


class ServiceProcess:
    """A service on this machine. It ends when this process ends, in any way.

    `name` is for people; `module` is run as `python -m`. `on_line` is called with each line that the process prints,
    except the ready line, and `on_exit` at each end of the process. Both are called on a separate thread and must not
    block. The process runs in `namespace`, if one is given. `stop` waits `stop_seconds` for its end; state more for a
    host with a longer `--drain-seconds`. Only one thread at a time may use the object.
    """

    popen_class: ClassVar[type[subprocess.Popen[bytes]]] = subprocess.Popen
    """Starts the processes."""

    def __init__(
        self,
        name: str,
        module: str,
        arguments: Sequence[str],
        *,
        on_line: Callable[[ServiceProcess, str], None] | None = None,
        on_exit: Callable[[ServiceProcess], None] | None = None,
        namespace: NetworkNamespace | None = None,
        stop_seconds: float = STOP_SECONDS,
    ) -> None:
        self.name = name
        self._stop_seconds = stop_seconds
        self.arguments = list(arguments)
        self._namespace = namespace
        self._module = module
        self._on_line = on_line
        self._on_exit = on_exit
        self._run: _Run | None = None

    @property
    def alive(self) -> bool:
        """Whether the process runs. It may be paused, or not ready yet."""
        return self._run is not None and self._run.popen.poll() is None

    @property
    def ended(self) -> bool:
        """Whether it was started and does not run any more."""
        return self._run is not None and not self.alive

    @property
    def is_ready(self) -> bool:
        """Whether its last start has printed the ready line."""
        return self._run is not None and self._run.address is not None

    @property
    def address(self) -> str:
        """The address in its ready line. Raises ServiceFailed before `wait_ready` has returned."""
        if self._run is None or self._run.address is None:
            raise ServiceFailed(f"{self.name} is not ready yet")
        return self._run.address

    @property
    def pid(self) -> int:
        """The process id of the last start. Raises ServiceFailed if it was never started."""
        return self._started().popen.pid

    @property
    def exit_code(self) -> int | None:
        """The exit status of the last start. None while it runs; negative: the number of the signal that ended it."""
        return self._started().popen.poll()

    @property
    def last_lines(self) -> list[str]:
        """Return its last lines, also of standard error; at most LAST_LINES_MAX."""
        return list(self._run.lines) if self._run else []

    def start(self) -> None:
        """Start the process and return immediately; `wait_ready` waits for it."""
        if self.alive:
            raise ServiceFailed(f"{self.name} is running already, as process {self.pid}")
        # With -P Python does not import modules of the user's present folder instead of ours.
        command = [sys.executable, "-P", "-m", "stampede_rt_runtime.parent_watch", self._module, *self.arguments]
        if self._namespace is not None:
            command = self._namespace.command(*command)
        self._run = _Run(self.popen_class, command, self._hear_line, self._hear_exit)

    def wait_ready(self, timeout: float, *, unless: Callable[[], bool] = lambda: False) -> str:
        """Wait for the ready line, `timeout` seconds at most, and return the address in it.

        Raises ServiceFailed after that time, or soon after `unless` returns True.
        """
        run = self._started()
        deadline = time.monotonic() + timeout
        while not run.ready_or_ended.wait(min(LOOK_SECONDS, max(0.0, deadline - time.monotonic()))):
            if unless() or time.monotonic() >= deadline:
                break
        if run.address is not None:
            return run.address
        if run.popen.poll() is None:
            raise ServiceFailed(self._story(f"is not ready after {timeout:g} s"))
        raise ServiceFailed(self._story(f"ended with exit code {run.popen.returncode} before it was ready"))

    def kill(self) -> None:
        """End it with SIGKILL, like a crash, and wait for its end. Does nothing if it does not run."""
        if self._run is not None:
            self._run.signal(signal.SIGKILL)
            self._run.wait(self._stop_seconds)

    def stop(self) -> None:
        """End it with SIGTERM; after `stop_seconds` with SIGKILL. Does nothing if it does not run."""
        if self._run is not None:
            self._run.ask_to_stop()
            self._run.wait(self._stop_seconds)

    def ask_to_stop(self) -> None:
        """Send SIGTERM and return immediately; `stop` then waits."""
        if self._run is not None:
            self._run.ask_to_stop()

    def restart(self, timeout: float = 40.0) -> str:
        """Stop it if it runs, start it again with the same arguments, and wait until it is ready."""
        self.stop()
        self.start()
        return self.wait_ready(timeout)

    def pause(self) -> None:
        """Freeze it with SIGSTOP. It keeps its connections and sends nothing, as on a machine that hangs."""
        self._started().signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let it go on after `pause`."""
        self._started().signal(signal.SIGCONT)

    def describe_end(self) -> str:
        """Return a text for people: that it ended, how, and its last lines."""
        return self._story(f"ended with exit code {self.exit_code}")

    def _hear_line(self, line: str) -> None:
        if self._on_line is not None:
            self._on_line(self, line)

    def _hear_exit(self) -> None:
        if self._on_exit is not None:
            self._on_exit(self)

    def _started(self) -> _Run:
        if self._run is None:
            raise ServiceFailed(f"{self.name} was never started")
        return self._run

    def _story(self, what: str) -> str:
        lines = "\n".join(f"    {line}" for line in self.last_lines[-15:])
        return f"{self.name} {what}; its last lines:\n{lines}" if lines else f"{self.name} {what}, and said nothing"


class _Run:
    """One run of the process, with a thread that reads its output until its end."""

    def __init__(
        self,
        popen_class: type[subprocess.Popen[bytes]],
        command: list[str],
        on_line: Callable[[str], None],
        on_exit: Callable[[], None],
    ) -> None:
        self.address: str | None = None
        self.lines: deque[str] = deque(maxlen=LAST_LINES_MAX)
        self.ready_or_ended = threading.Event()
        self._on_line = on_line
        self._on_exit = on_exit
        self._stop_requested = False
        self.popen = popen_class(
            command,
            stdin=subprocess.PIPE,  # `parent_watch` reads it; the kernel closes it when this process ends
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=_environment(),
            process_group=0,  # only this process gets Ctrl-C of the terminal, and then stops the services
        )
        self._reader = threading.Thread(target=self._read, name=f"read {self.popen.pid}", daemon=True)
        self._reader.start()

    def signal(self, number: signal.Signals) -> None:
        """Send a signal. Does nothing if the process has ended."""
        with contextlib.suppress(ProcessLookupError):
            self.popen.send_signal(number)

    def ask_to_stop(self) -> None:
        """Send SIGTERM only once, because a second one would make the service stop its drain."""
        if not self._stop_requested:
            self._stop_requested = True
            self.signal(signal.SIGTERM)
            self.signal(signal.SIGCONT)  # a paused process gets no other signal

    def wait(self, timeout: float) -> None:
        """Wait for the end; after `timeout` seconds send SIGKILL. When this returns, its whole output is read."""
        try:
            self.popen.wait(timeout)
        except subprocess.TimeoutExpired:
            self.signal(signal.SIGKILL)
            self.popen.wait()
        self._reader.join(timeout)
        assert self.popen.stdin is not None
        self.popen.stdin.close()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        with self.popen.stdout as output:
            for line in _lines(output):
                self.lines.append(line)
                if self.address is None and (match := _READY.fullmatch(line)):
                    self.address = match[1]
                    self.ready_or_ended.set()
                else:
                    self._on_line(line)
        self.popen.wait()
        self.ready_or_ended.set()
        self._on_exit()


def _lines(output: IO[bytes]) -> Iterator[str]:
    while line := output.readline(LINE_CHARS_MAX):
        yield line.decode(errors="replace").rstrip("\n")


def _environment() -> dict[str, str]:
    """Return this process's environment without our variables: a service's settings come only from its arguments."""
    return {name: value for name, value in os.environ.items() if not name.startswith("STAMPEDE_")}
