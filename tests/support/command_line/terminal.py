"""Runs commands of the command line in this process, with a pseudo-terminal as standard input and output."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import sys
import termios
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import pytest

from stampede_rt.cli.commands import run

_STYLES = re.compile(r"\x1b\[[0-9;]*m")  # colours, and bold or dim text
_STYLES_AND_MOVES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")  # colours, and moves of the cursor


@dataclass(frozen=True)
class TerminalRun:
    """A finished command: its exit status, and all text that it wrote to the terminal on both outputs."""

    status: int
    written: str

    @property
    def text(self) -> str:
        """The written text without styles and moves of the cursor, with plain ends of lines."""
        return _STYLES_AND_MOVES.sub("", self.written).replace("\r\n", "\n")

    @property
    def lines(self) -> list[str]:
        """The lines of `text`."""
        return self.text.splitlines()

    def controls(self, *, moves_cursor: bool = False) -> set[str]:
        """The characters that could control the terminal, except ends of lines and styles.

        `moves_cursor`: the command may also move the cursor, as a live view does.
        """
        allowed = _STYLES_AND_MOVES if moves_cursor else _STYLES
        rest = allowed.sub("", self.written).replace("\r\n", "").replace("\t", "")
        return {one for one in rest if not one.isprintable()}


def run_in_terminal(
    words: Sequence[str], *, columns: int = 100, rows: int = 40, typed: bytes = b"", answered: bytes = b""
) -> TerminalRun:
    """Run one command in this process on a terminal of that size.

    `typed`: the user's input before the command begins. `answered`: the user's input after the first output.
    """
    pieces: list[bytes] = []
    with pytest.MonkeyPatch.context() as patch, _terminal(columns, rows, pieces, answered) as (master, slave):
        os.write(master, typed)
        for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
            file = open(os.dup(slave), mode, encoding="utf-8", errors="backslashreplace")  # noqa: SIM115
            patch.setattr(sys, name, file)
            patch.setattr(sys, f"__{name}__", file)
        try:
            status = run(words)
        except SystemExit as end:
            status = int(end.code or 0)
        for name in ("stdin", "stdout", "stderr"):
            getattr(sys, name).close()
    return TerminalRun(status, b"".join(pieces).decode("utf-8", "backslashreplace"))


@contextmanager
def _terminal(columns: int, rows: int, pieces: list[bytes], answered: bytes) -> Iterator[tuple[int, int]]:
    """A pseudo-terminal without echo. Until the block ends, a thread appends the written bytes to `pieces`."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    attributes = termios.tcgetattr(slave)
    attributes[3] &= ~termios.ECHO
    termios.tcsetattr(slave, termios.TCSANOW, attributes)

    def read() -> None:
        while True:
            try:
                piece = os.read(master, 65536)
            except OSError:  # the last writer has closed the terminal
                return
            if not piece:
                return
            if not pieces:
                os.write(master, answered)
            pieces.append(piece)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        yield master, slave
    finally:
        os.close(slave)
        reader.join(timeout=20)
        os.close(master)
