"""Colours on a terminal. Text stays plain if there is no terminal, if `$NO_COLOR` is set, or if `$TERM` is "dumb"."""

from __future__ import annotations

import os
from typing import Literal, TextIO

Style = Literal["bold", "red", "green", "yellow"]
_CODES: dict[Style, str] = {"bold": "1", "red": "31", "green": "32", "yellow": "33"}


def styled(text: str, style: Style, file: TextIO) -> str:
    """Return `text` in a style, if `file` shows styles. See https://no-color.org."""
    if not file.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return text
    return f"\x1b[{_CODES[style]}m{text}\x1b[0m"
