"""Callers that wait for a supernode go on a few in each turn of the event loop."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

from stampede_rt_frontend.probe import WOKEN_PER_TURN, Prober
from stampede_rt_frontend.roster import SupernodeRoster

CALLERS = 200


async def test_callers_that_wait_for_a_supernode_go_on_a_few_in_each_turn() -> None:
    healthy = False
    roster: Any = SupernodeRoster(("s:1",))
    prober = Prober(_JudgedRoster(lambda: healthy), lambda target: roster)
    turns: Counter[int] = Counter()
    turn = 0

    async def wait() -> None:
        assert await prober.wait_healthy(30)
        turns[turn] += 1

    callers = [asyncio.create_task(wait()) for _ in range(CALLERS)]
    gone = asyncio.create_task(prober.wait_healthy(30))
    await asyncio.sleep(0)
    gone.cancel()
    await asyncio.sleep(0)
    assert len(prober._waiting) == CALLERS
    healthy = True
    prober._wake_some()
    while not all(caller.done() for caller in callers):
        turn += 1
        await asyncio.sleep(0)
    assert max(turns.values()) <= 2 * WOKEN_PER_TURN
    assert not prober._waiting


class _JudgedRoster(SupernodeRoster):
    """A roster whose health a test decides."""

    __slots__ = ("_judge",)

    def __init__(self, judge: Any) -> None:
        super().__init__(("s:1",))
        self._judge = judge

    def any_healthy(self) -> bool:
        return bool(self._judge())
