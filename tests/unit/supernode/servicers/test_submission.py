"""Commands under way at one supernode."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import Overloaded, Unavailable
from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.servicers import submission as module
from stampede_rt_supernode.servicers.submission import Submission
from tests.support.supernode.memory_log import MemoryLog
from tests.support.supernode.operations import begin_tenure, id_of, open_channel, register


class SlowLog(MemoryLog):
    """Commits a command only when `may_continue` is set."""

    def __init__(self, replica: DirectoryReplica) -> None:
        super().__init__(replica)
        self.may_continue = asyncio.Event()

    async def propose(self, command: bytes, *, timeout: float) -> Any:
        await self.may_continue.wait()
        return await super().propose(command, timeout=timeout)


async def test_one_caller_cannot_fill_the_log(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, one caller with very many parallel calls filled the line of commands that wait for the
    log.
    """
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
    log.may_continue.set()
    await asyncio.gather(*begun, *greedy, *others)
    await submit(open_channel("g/3"), ChannelOpened, "greedy")
    assert not submission._under_way


class LaggingReplica(DirectoryReplica):
    """Refuses commands until the log has confirmed a read: before that it does not know the risen feature level."""

    lags = True

    def takes(self, command: bytes) -> bool:
        return not self.lags and super().takes(command)


class TimedLog(MemoryLog):
    """Confirms a read after `read_seconds` of the manual clock `seconds`, and notes how long each command may wait."""

    def __init__(self, replica: LaggingReplica, read_seconds: float) -> None:
        super().__init__(replica)
        self.seconds = 100.0
        self.waits: list[float] = []
        self._replica = replica
        self._read_seconds = read_seconds

    async def confirm_read(self, *, timeout: float) -> int:
        self.seconds += self._read_seconds
        self._replica.lags = False
        return await super().confirm_read(timeout=timeout)

    async def propose(self, command: bytes, *, timeout: float) -> Any:
        self.waits.append(timeout)
        return await super().propose(command, timeout=timeout)


@pytest.mark.parametrize(("read_seconds", "waits"), [(1.5, [0.5]), (2.0, [])])
async def test_the_time_in_which_the_feature_level_is_confirmed_counts_against_the_wait_of_the_command(
    monkeypatch: pytest.MonkeyPatch, read_seconds: float, waits: list[float]
) -> None:
    """In an earlier version, the command could wait for its full time again after the read."""
    replica = LaggingReplica()
    log = TimedLog(replica, read_seconds)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: log.seconds))
    submission = Submission(log, replica, time_unix_nano=lambda: 1)
    made = submission.submit(begin_tenure(), object, op_id=id_of(1), seconds=2.0)  # type: ignore[type-var]
    if waits:
        await made
    else:
        with pytest.raises(Unavailable, match="no majority"):
            await made
    assert log.waits == waits
