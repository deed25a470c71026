"""Logs the names of things to which the same happens. Many of them within a short time share a line.

A drain moves hundreds of channels a second. A line for each of them took a tenth of the host's CPU time.
"""

from __future__ import annotations

import asyncio
import logging

GATHER_SECONDS = 0.1
NAMES_MAX = 20  # in one line


class NameLog:
    """One kind of thing, and one event. Belongs to one event loop.

    The first name has a line immediately, with a field such as `channel`. The names of the next GATHER_SECONDS share
    lines of up to NAMES_MAX names, with the fields `channels` and `count`.
    """

    def __init__(self, logger: logging.Logger, thing: str, text: str, *, event: str) -> None:
        """`thing` is a noun such as "channel". `text` is the rest of the message, such as "moved here"."""
        self._logger = logger
        self._thing, self._text, self._event = thing, text, event
        self._names: list[str] = []
        self._timer: asyncio.TimerHandle | None = None

    def note(self, name: str) -> None:
        """Log the name, now or in the next line."""
        self._names.append(name)
        if self._timer is None:
            self._write_and_gather()
        elif len(self._names) == NAMES_MAX:
            self._write()

    def close(self) -> None:
        """Log the names that wait."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._write()

    def _write_and_gather(self) -> None:
        """Log the names that wait, and gather the next ones for a time.

        If no names wait, the next name gets a line immediately.
        """
        self._timer = None
        if self._names:
            self._timer = asyncio.get_running_loop().call_later(GATHER_SECONDS, self._write_and_gather)
        self._write()

    def _write(self) -> None:
        names, self._names = self._names, []
        if len(names) == 1:
            self._log(f"a {self._thing} has", {self._thing: names[0]})
        elif names:
            self._log(f"{self._thing}s have", {f"{self._thing}s": ", ".join(names), "count": len(names)})

    def _log(self, subject: str, facts: dict[str, object]) -> None:
        self._logger.info("%s %s", subject, self._text, extra={"event": self._event, **facts})
