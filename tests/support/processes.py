"""Starts processes for a test, and ends them with it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any


@contextmanager
def started(command: Sequence[str], **settings: Any) -> Iterator[subprocess.Popen[str]]:
    """Yield a process with text pipes for its input and output. Kill it at the end of the block if it still runs.

    At that point `with subprocess.Popen(...)` would wait without a limit, and a failed test would never end.
    """
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **(pipes | settings)) as process:
        try:
            yield process
        finally:
            process.kill()
