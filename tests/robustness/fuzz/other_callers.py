"""Callers of queues and groups, and peers that come and go."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

import stampede_rt as st
from tests.robustness.fuzz.calling import ENDED, FAILED, INTERRUPTED, CallingClient
from tests.robustness.fuzz.channel_callers import payload_of
from tests.robustness.fuzz.ledger import Ledger

LEASE = "1s"
NO_MESSAGE = (None, FAILED, INTERRUPTED)


async def enqueue(calling: CallingClient, queue: Any, ledger: Ledger, who: str, over: asyncio.Event) -> None:
    """Put messages one after the other."""
    number = 0
    while not over.is_set():
        payload = payload_of(calling, who, number := number + 1)
        outcome = await calling.outcome("put into a queue", calling.plain(queue.put, payload, 1), 1)
        (ledger.open if outcome in (INTERRUPTED, FAILED) else ledger.accepted).add(payload)


class Takers:
    """The takers of one queue, and the messages that they acknowledged."""

    def __init__(self) -> None:
        self.acknowledged: Counter[bytes] = Counter()
        self.unsure: set[bytes] = set()  # the acknowledgement was interrupted, or failed

    async def take(self, calling: CallingClient, queue: Any, over: asyncio.Event) -> None:
        """Get messages. Acknowledge each one, give it back, or leave it."""
        while not over.is_set():
            timeout = calling.rng.choice([0, 0.05, 1, None if calling.is_async else 1])
            call = calling.plain(queue.get, timeout)
            message = await calling.outcome("get from a queue", call, timeout or 0, endless=timeout is None)
            if message not in NO_MESSAGE:
                await self._settle(calling, message)

    async def take_the_rest(self, calling: CallingClient, queue: Any) -> None:
        """Take messages until the queue holds none."""
        async with asyncio.timeout(60):
            while (await calling.plain(queue.stats)).held:
                message = await calling.plain(queue.get, 0.5)
                if message is not None:
                    await calling.plain(message.ack)
                    self.acknowledged[message.payload] += 1

    async def _settle(self, calling: CallingClient, message: Any) -> None:
        kind = calling.rng.random()
        if kind < 0.1:
            return
        if kind < 0.2:
            await calling.outcome("nack", settles_in_time(calling, message.nack))
            return
        outcome = await calling.outcome("ack", settles_in_time(calling, message.ack))
        if outcome in (FAILED, INTERRUPTED):
            self.unsure.add(message.payload)
        elif outcome:
            self.acknowledged[message.payload] += 1


async def settles_in_time(calling: CallingClient, settle: Any) -> bool:
    """Settle a message. Returns whether this succeeded before the lease of the message ended."""
    try:
        await calling.plain(settle)
    except st.LeaseExpired:
        return False
    return True


async def read_group(calling: CallingClient, group: Any, over: asyncio.Event) -> None:
    """Read the group at one cut, again and again."""
    while not over.is_set():
        call = group.newest if calling.rng.random() < 0.5 else group.get
        arguments = () if call == group.newest else (st.OLDEST, st.NEWEST)
        await calling.outcome("read of a group", calling.plain(call, *arguments, payloads=False), 1)


async def follow_matches(calling: CallingClient, group: Any, per: Any, over: asyncio.Event) -> None:
    """Follow the matches. Check that each item has at most one."""
    stream = await opened(calling, group.match, per, "1s", partial=True)
    seen = await results_of(calling, stream, over)
    seqs = [(match[per].incarnation, match[per].seq) for match in seen]
    assert len(set(seqs)) == len(seqs), "a match came twice"


async def follow_cuts(calling: CallingClient, group: Any, over: asyncio.Event) -> None:
    """Follow the cut events. Check that their times ascend, and that they have each item at most once."""
    stream = await opened(calling, group.subscribe, "100ms")
    events = await results_of(calling, stream, over)
    times = [cut.time for cut in events]
    assert times == sorted(set(times)), "cuts do not ascend"
    delivered = [
        (channel.name, item.incarnation, item.seq)
        for cut in events
        for channel in cut
        for item in (*cut[channel], *cut.late[channel])
    ]
    assert len(set(delivered)) == len(delivered), f"{len(delivered)} entries, {len(set(delivered))} of them distinct"


async def opened(calling: CallingClient, make: Any, *arguments: Any, **named: Any) -> Any:
    """Open a stream. Try again after an interruption or a failure.

    The blocking client waits in this call until the stream is open. The asyncio client waits for this later.
    """
    while True:
        stream = await calling.outcome("subscribe to a group", calling.plain(make, *arguments, **named))
        if stream not in (FAILED, INTERRUPTED):
            return stream


async def results_of(calling: CallingClient, stream: Any, over: asyncio.Event) -> list[Any]:
    """The results of a stream until its end. Closes the stream when `over` is set."""
    seen: list[Any] = []
    ending = asyncio.ensure_future(_close_when(over, stream))
    while True:
        result = await calling.outcome("step", calling.step(stream), endless=True)
        if result is ENDED:
            await ending
            return seen
        if result not in (FAILED, INTERRUPTED):
            seen.append(result)


async def _close_when(over: asyncio.Event, stream: Any) -> None:
    await over.wait()
    stream.close()
