"""Shows progress: one changing line on a terminal, or otherwise a plain line every few seconds."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from typing import TextIO

PLAIN_PERIOD_SECONDS = 4.0
_CLEAR_LINE = "\r\x1b[K"


class Progress:
    """Writes progress to `output`.

    `say` writes a line that stays. `show` may be called often. On a terminal its line replaces the line of the `show`
    before. Elsewhere it writes a plain line, but at most one in PLAIN_PERIOD_SECONDS.
    """

    def __init__(self, output: TextIO, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._output = output
        self._monotonic = monotonic
        self._terminal = output.isatty()
        self._open = False  # whether the terminal shows a line that the next line replaces
        self._shown: float | None = None

    def print_line(self, text: str) -> None:
        """Write a line that stays."""
        self.close()
        print(text, file=self._output, flush=True)

    def show(self, text: str) -> None:
        """Show `text` in the changing line of the terminal. Elsewhere print it, unless the last such line is recent."""
        if self._terminal:
            columns = shutil.get_terminal_size().columns
            print(f"{_CLEAR_LINE}{text[: columns - 1]}", end="", file=self._output, flush=True)
            self._open = True
            return
        now = self._monotonic()
        if self._shown is None or now - self._shown >= PLAIN_PERIOD_SECONDS:
            self._shown = now
            print(text, file=self._output, flush=True)

    def close(self) -> None:
        """Remove the changing line. Idempotent."""
        if self._open:
            print(_CLEAR_LINE, end="", file=self._output, flush=True)
            self._open = False
