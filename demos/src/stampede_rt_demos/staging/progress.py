"""Progress on the terminal: one line that changes, or a plain line every few seconds where there is no terminal."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from typing import TextIO

PLAIN_PERIOD_SECONDS = 4.0
_CLEAR_LINE = "\r\x1b[K"


class Progress:
    """Writes to `output`. `show` may be called as often as one likes; `say` writes a line that stays."""

    def __init__(self, output: TextIO, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._output = output
        self._monotonic = monotonic
        self._terminal = output.isatty()
        self._open = False  # the cursor stands behind a line that will be overwritten
        self._shown: float | None = None

    def say(self, text: str) -> None:
        """A line of its own."""
        self.close()
        print(text, file=self._output, flush=True)

    def show(self, text: str) -> None:
        """Where things stand now: replaces what was shown before, or is left out if something was shown just now."""
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
        """Take away the line that would have been overwritten next. Idempotent."""
        if self._open:
            print(_CLEAR_LINE, end="", file=self._output, flush=True)
            self._open = False
