"""The progress of long work, as one line on the terminal. It goes to standard error, and only if that is a terminal."""

from __future__ import annotations

import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

EVERY_S = 0.2
BAR_CHARACTERS = 24
ERASE = "\r\x1b[K"  # to the first column; erase the line

Progress = tuple[float | None, str]
"""The done share of the work, from 0 to 1, or None if the whole is not known; and a text."""


@contextmanager
def shown_progress(look: Callable[[], Progress]) -> Iterator[None]:
    """Show the text that `look` returns, again and again, until the end of the block. Then erase the line.

    `look` runs on a thread of its own. If it fails, the line stays as it is.
    """
    if not sys.stderr.isatty():
        yield
        return
    over = threading.Event()
    thread = threading.Thread(target=_show, args=(look, over), name="stampede progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(EVERY_S)
        sys.stderr.write(ERASE)
        sys.stderr.flush()


def _show(look: Callable[[], Progress], over: threading.Event) -> None:
    try:
        while not over.wait(EVERY_S):
            line = progress_line(*look(), shutil.get_terminal_size().columns)
            if not over.is_set():
                sys.stderr.write(ERASE + line)
                sys.stderr.flush()
    except Exception:  # noqa: BLE001 # the work itself reports its errors
        return


def progress_line(share: float | None, text: str, columns: int) -> str:
    """Return a bar with the done share, and the text, within the width of the terminal."""
    if share is None:
        return text[: columns - 1]
    share = min(max(share, 0.0), 1.0)
    done = round(share * BAR_CHARACTERS)
    return f"[{'#' * done}{'.' * (BAR_CHARACTERS - done)}] {share:4.0%}  {text}"[: columns - 1]
