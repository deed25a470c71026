"""Runs commands of the command line in this process, with files as standard streams: `<in >out 2>errors`.

The start of a process takes a third of a second of CPU time, so only the tests about the process itself start one.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack

import pytest

from stampede_rt.cli.main import main


def run_redirected(words: Sequence[str], *, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    """Run one command in this process, and return its status and its output."""
    with ExitStack() as stack, pytest.MonkeyPatch.context() as patch:
        files = {name: stack.enter_context(tempfile.TemporaryFile()) for name in ("stdin", "stdout", "stderr")}
        files["stdin"].write(stdin)
        files["stdin"].seek(0)
        for name, file in files.items():
            patch.setattr(sys, name, stack.enter_context(io.TextIOWrapper(file, encoding="utf-8")))
        try:
            status = main(list(words))
        except SystemExit as end:
            status = int(end.code or 0)
        written = []
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
            stream.buffer.seek(0)
            written.append(stream.buffer.read())
    return subprocess.CompletedProcess(list(words), status, *written)
