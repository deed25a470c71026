"""Plans of moves: the hosts that take part."""

from __future__ import annotations

from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._async.moves import Moves
from stampede_rt.values.model import LoadInfo, Policy


class Cluster(Moves):
    """Three hosts. The counters of `failing` cannot be read for a second time."""

    def __init__(self, failing: st.StampedeError) -> None:
        self._failing = failing
        self._reads = 0

    async def hosts(self, *, include_dead: bool = False) -> list[Any]:
        loads = {"busy": 900, "failing": 0, "free": 100}
        return [_Host(name, permille) for name, permille in loads.items()]

    async def hosted_channels(self, host: str, name_glob: str = "*") -> dict[str, Any]:
        self._reads += host == "failing"
        if host == "failing" and self._reads == 2:
            raise self._failing
        return {name: _Counters() for name in ("a", "b", "c")} if host == "busy" else {}

    async def channels(self, name_glob: str = "*") -> list[Any]:
        return [_Channel(name) for name in ("a", "b", "c")]

    async def groups(self, name_glob: str = "*") -> list[Any]:
        return []


class _Host:
    def __init__(self, name: str, busy_permille: int) -> None:
        self.name = name
        self.load = LoadInfo(busy_permille=busy_permille, held_bytes=0, bytes_max=0)


class _Counters:
    accepted_bytes = delivered_bytes = accepted = 0


class _Channel:
    def __init__(self, name: str) -> None:
        self.name = name
        self.channel_id = name.encode()
        self.host = "busy"
        self.policy = Policy()


@pytest.mark.parametrize("failure", [st.HostNotFound("it has left"), st.Unavailable("it is silent")])
async def test_a_host_that_leaves_during_the_measurement_takes_no_part_in_the_plan(failure: st.StampedeError) -> None:
    planned = await Cluster(failure).rebalance(over="1ns")
    assert {step.host for step in planned} == {"free"}


async def test_a_plan_needs_the_right_to_read_the_counters() -> None:
    with pytest.raises(st.PermissionDenied):
        await Cluster(st.PermissionDenied("no operator")).rebalance(over="1ns")
