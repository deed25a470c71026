"""Processes that a test starts by itself, none of which outlives it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any


@contextmanager
def started(command: Sequence[str], **settings: Any) -> Iterator[subprocess.Popen[str]]:
    """A process with pipes for its input and output, in text. What still runs behind the block is killed.

    `with subprocess.Popen(...)` waits there without a limit, so that a failed test would never end.
    """
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **(pipes | settings)) as process:
        try:
            yield process
        finally:
            process.kill()
