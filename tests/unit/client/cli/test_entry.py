"""Ctrl-C while the modules of the command line load."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

INTERRUPTED_IMPORT = """
import os, signal, sys
{before}
class Interrupting:
    def find_spec(self, name, path, target=None):
        if name == "stampede_rt.cli.interrupts":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
from stampede_rt.cli.entry import main
sys.argv = ["stampede", "--version"]
sys.exit(main())
"""


@pytest.mark.parametrize(
    ("before", "status"), [("", -signal.SIGINT), ("signal.signal(signal.SIGINT, signal.SIG_IGN)", 0)]
)
def test_ctrl_c_during_an_import_ends_the_command_without_a_traceback(before: str, status: int) -> None:
    program = INTERRUPTED_IMPORT.format(before=before)
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stderr) == (status, "")
