"""Commands under way at one supernode."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.servicers import submission as module
from stampede_rt_supernode.servicers.submission import Submission
from tests.support.supernode.memory_log import MemoryLog
from tests.support.supernode.operations import begin_tenure, id_of, open_channel, register


class SlowLog(MemoryLog):
    """Commits a command only when `go_on` is set."""

    def __init__(self, replica: DirectoryReplica) -> None:
        super().__init__(replica)
        self.go_on = asyncio.Event()

    async def propose(self, command: bytes, *, timeout: float) -> Any:
        await self.go_on.wait()
        return await super().propose(command, timeout=timeout)


async def test_one_caller_leaves_room_in_the_log_for_the_commands_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """One caller with very many calls at the same time filled the line of commands that wait for the log."""
    monkeypatch.setattr(module, "UNDER_WAY_OF_ONE_MAX", 3)
    replica = DirectoryReplica()
    log = SlowLog(replica)
    submission = Submission(log, replica, time_unix_nano=lambda: 1)
    numbers = iter(range(1, 100))

    def submit(operation: Any, kind: Any, caller: str = "") -> asyncio.Task[Any]:
        made = submission.submit(operation, kind, op_id=id_of(next(numbers)), seconds=10, caller=caller)
        return asyncio.ensure_future(made)

    begun = [submit(begin_tenure(), object), submit(register(1), object)]
    greedy = [submit(open_channel(f"g/{number}"), ChannelOpened, "greedy") for number in range(3)]
    others = [submit(open_channel(f"o/{caller}"), ChannelOpened, caller) for caller in ("good", "")]
    await asyncio.sleep(0)
    with pytest.raises(Overloaded, match="3 changes of greedy are under way at this supernode"):
        await submit(open_channel("g/3"), ChannelOpened, "greedy")
    log.go_on.set()
    await asyncio.gather(*begun, *greedy, *others)
    await submit(open_channel("g/3"), ChannelOpened, "greedy")
    assert not submission._under_way
