"""A large request keeps its reserved bytes until the host judges it, so that requests that wait for a turn have a
bound.
"""

from __future__ import annotations

import inspect

import pytest

from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_runtime.quotas.working import CallerWork
from tests.support.channel_host.queue_rig import running_queue_host
from tests.support.channel_host.rig import run_of, running_host

PAYLOAD = bytes(600_000)  # comes in three pieces


@pytest.fixture
def room_in_turns(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Make every step of every caller wait for a turn. Returns a list, which gets an entry at each of these waits: the
    name of the waiting function, and the reserved bytes of all large requests.
    """
    found: list[tuple[str, int]] = []
    budgets: list[MemoryBudget] = []
    made = MemoryBudget.__init__

    def making(self: MemoryBudget, *arguments: object, **named: object) -> None:
        made(self, *arguments, **named)  # type: ignore[arg-type]
        budgets.append(self)

    async def turn(self: CallerWork) -> None:
        waiting = inspect.currentframe()
        assert waiting is not None
        assert waiting.f_back is not None
        found.append((waiting.f_back.f_code.co_name, budgets[-1].requests.used_bytes))

    monkeypatch.setattr(MemoryBudget, "__init__", making)
    monkeypatch.setattr(CallerWork, "must_wait", property(lambda self: True))
    monkeypatch.setattr(CallerWork, "turn", turn)
    return found


def room_of(turns: list[tuple[str, int]], *functions: str) -> int:
    """Return how often one of the functions waited. Checks that the request had its reserved bytes each time."""
    room_bytes = [taken_bytes for function, taken_bytes in turns if function in functions]
    assert all(taken_bytes > len(PAYLOAD) for taken_bytes in room_bytes)
    return len(room_bytes)


async def test_a_large_put_keeps_its_reserved_bytes_while_it_waits_for_its_turn(
    room_in_turns: list[tuple[str, int]],
) -> None:
    async with running_host() as rig:
        channel = await rig.open()
        room_in_turns.clear()
        (ack,) = await channel.put(run_of(PAYLOAD))
        assert not ack.HasField("error")
        assert room_of(room_in_turns, "_turn_within", "_take") == 3
        assert rig.host.store.memory.requests.used_bytes == 0


async def test_a_large_enqueue_keeps_its_reserved_bytes_while_it_waits_for_its_turn(
    room_in_turns: list[tuple[str, int]],
) -> None:
    async with running_queue_host() as rig:
        queue = rig.open()
        room_in_turns.clear()
        ack = await queue.put(PAYLOAD)
        assert not ack.HasField("error")
        assert room_of(room_in_turns, "_turn_within", "_take") == 3
        assert rig.host.store.memory.requests.used_bytes == 0
