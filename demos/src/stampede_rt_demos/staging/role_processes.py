"""Starts the processes of the roles, reads their reports, and ends them in every case.

Each role has two reader threads here, one for its reports and one for its standard error. Both are bounded: at most
EVENTS_MAX events wait in a queue, and a role that reports more must wait. This module keeps the last LAST_LINES_MAX
lines of the standard error.
"""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging import messages

EVENTS_MAX = 1000
LAST_LINES_MAX = 20
END_SECONDS = 3.0
_POLL_SECONDS = 0.2


@dataclass(slots=True)
class _Role:
    name: str
    process: subprocess.Popen[str]
    last_lines: deque[str] = field(default_factory=lambda: deque(maxlen=LAST_LINES_MAX))
    readers: list[threading.Thread] = field(default_factory=list)
    finished: bool = False  # whether the orchestrator has read the role's result


class RoleProcesses:
    """A set of role processes, and a context manager that ends all of them. Use it from one thread.

    Order of use: `start` each role, read `events` until each role is `ready`, call `begin`, and read `events` again.
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        self._environment = {**os.environ, **(environment or {})}
        self._roles: dict[str, _Role] = {}
        self._events: queue.Queue[tuple[str, str | None]] = queue.Queue(EVENTS_MAX)
        self._closing = threading.Event()

    def __enter__(self) -> RoleProcesses:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.end()

    @property
    def process_ids(self) -> Mapping[str, int]:
        """The roles' process ids, by name."""
        return {name: role.process.pid for name, role in self._roles.items()}

    def start(self, name: str, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        """Start a role. `environment` adds variables for only this role. Raises DemoFailed if it cannot start."""
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env={**self._environment, **(environment or {})},
                text=True,
                encoding="utf-8",
                errors="replace",
                process_group=0,  # only the orchestrator gets Ctrl-C, and then ends the roles
            )
        except OSError as error:
            raise DemoFailed(f"the {name} cannot be started with {command[0]}: {error.strerror}") from error
        role = self._roles[name] = _Role(name, process)
        for target in (self._read_events, self._read_last_lines):
            reader = threading.Thread(target=target, args=(role,), name=f"{target.__name__} {name}", daemon=True)
            reader.start()
            role.readers.append(reader)

    def begin(self, start_unix_nano: int) -> None:
        """Tell every role when the programme starts."""
        for role in self._roles.values():
            with contextlib.suppress(BrokenPipeError):  # the role has died; `events` reports it with the reason
                assert role.process.stdin is not None
                role.process.stdin.write(messages.encode_start(start_unix_nano) + "\n")
                role.process.stdin.flush()

    def events(self, timeout: float, doing: str) -> Iterator[tuple[str, messages.Message]]:
        """Yield the reports of the roles, until every role has given its result.

        Raises DemoFailed if a role fails, dies, or sends an invalid report, or after `timeout` seconds; the error then
        names the work, `doing`. A caller may stop early and call again for the next phase.
        """
        deadline = time.monotonic() + timeout
        while unfinished := [role.name for role in self._roles.values() if not role.finished]:
            try:
                name, line = self._events.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                waiting = ", ".join(unfinished)
                raise DemoFailed(f"{doing} took more than {timeout:.0f} s; still waiting for {waiting}") from None
            message = self._message(self._roles[name], line)
            if message is not None:
                yield name, message

    def end(self) -> None:
        """Ask every role that still runs to end, and kill it after END_SECONDS. Idempotent."""
        self._closing.set()
        for role in self._roles.values():
            if role.process.poll() is None:
                role.process.terminate()
        for role in self._roles.values():
            self._end(role)

    def _end(self, role: _Role) -> None:
        try:
            role.process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            role.process.kill()
            role.process.wait()
        for reader in role.readers:
            reader.join(END_SECONDS)
        with contextlib.suppress(BrokenPipeError):  # the close writes a start line that a dead role has not read
            if role.process.stdin is not None:
                role.process.stdin.close()

    def _message(self, role: _Role, line: str | None) -> messages.Message | None:
        if line is None:
            if not role.finished:
                raise DemoFailed(self._how_it_ended(role))
            return None
        try:
            message = messages.decode(line)
        except messages.BadMessage as error:
            raise DemoFailed(f"the {role.name} sent a line that is not a report: {error}") from error
        if message["event"] == "failed":
            raise DemoFailed(f"the {role.name} failed: {message['message']}")
        role.finished = message["event"] == "result"
        return message

    def _how_it_ended(self, role: _Role) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            role.process.wait(END_SECONDS)
        role.readers[1].join(END_SECONDS)
        code = role.process.returncode
        how = f"was killed by signal {-code}" if code is not None and code < 0 else f"ended with exit code {code}"
        last_line = next((line.strip() for line in reversed(role.last_lines) if line.strip()), None)
        ended = f"the {role.name} {how} before its work was done"
        return f"{ended}; it said last: {last_line}" if last_line else ended

    def _read_events(self, role: _Role) -> None:
        assert role.process.stdout is not None
        for line in _lines(role.process.stdout):
            self._report(role.name, line)
        self._report(role.name, None)

    def _report(self, name: str, line: str | None) -> None:
        while not self._closing.is_set():
            with contextlib.suppress(queue.Full):
                self._events.put((name, line), timeout=_POLL_SECONDS)
                return

    def _read_last_lines(self, role: _Role) -> None:
        assert role.process.stderr is not None
        for line in _lines(role.process.stderr):
            role.last_lines.append(line)


def role_command(demo: str, module: str, address: str, seconds: int) -> list[str]:
    """Return the command that runs a role with this interpreter. `demo` and `module` are the names of the modules."""
    name = f"stampede_rt_demos.{demo}.{module}"
    return [sys.executable, "-m", name, "--address", address, "--seconds", str(seconds)]


def _lines(output: IO[str]) -> Iterator[str]:
    with output:
        while line := output.readline(messages.LINE_BYTES_MAX):
            yield line.rstrip("\n")
