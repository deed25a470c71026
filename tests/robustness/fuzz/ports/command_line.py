"""The command line after hostile callers: the names that they left must not send commands to a terminal."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Mapping

from tests.robustness.fuzz.ports.outcome import Finding, Outcome

COMMANDS = (
    *("ls", "ls -l", "ls -l -o json", "info a", "get a --start oldest --end newest", "get a -o jsonl", "peers"),
    *("queue ls", "queue info q", "queue pending q", "queue get q --count 3", "group ls", "group status g", "doctor"),
)
COMMAND_SECONDS = 60.0


async def check_commands(credentials: Mapping[str, str], outcome: Outcome) -> None:
    """Check that each command ends by itself, without a defect, and prints only text."""
    environment = {**os.environ, **credentials}
    for command in COMMANDS:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "stampede_rt.cli", *command.split()),
            env=environment,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        try:
            async with asyncio.timeout(COMMAND_SECONDS):
                printed, _ = await process.communicate()
        except TimeoutError:
            process.kill()
            outcome.add(Finding(what=f"has not ended after {COMMAND_SECONDS:g} s", method=f"stampede {command}"))
            continue
        _check(command, printed.decode(errors="replace"), outcome)


def _check(command: str, printed: str, outcome: Outcome) -> None:
    strange = sorted({one for one in printed if not one.isprintable() and one != "\n"})
    if strange:
        outcome.add(Finding(what=f"prints {strange!r}: {printed[:300]!r}", method=f"stampede {command}"))
    if "a defect" in printed or "Traceback" in printed:
        outcome.add(Finding(what=printed[-500:], method=f"stampede {command}"))
