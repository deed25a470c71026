"""The bound on moves under way, and the share of each client that has made channels or queues."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.copies.moves.move_slots import MOVES_MAX, OF_ONE_SHARE, QUEUE_MOVES_MAX, MoveSlots
from stampede_rt_channel_host.core.records import RecordedChannel

OF_ONE_MAX = int(OF_ONE_SHARE * MOVES_MAX)
MADE = RecordedChannel(
    channel_id=b"c" * 16,
    name="c",
    host_id=b"h" * 16,
    epoch=1,
    incarnation=1,
    spec_version=1,
    policy=Policy(),
    message=b"",
)


def test_the_channels_of_one_creator_cannot_use_all_moves() -> None:
    slots = MoveSlots("to host h1")
    mine, others = (replace(MADE, created_by=name) for name in ("cam", "imu"))
    for _ in range(OF_ONE_MAX):
        slots.take(mine)
    with pytest.raises(Overloaded, match=f"cam has created {OF_ONE_MAX} of the channels that move to host h1 already"):
        slots.take(mine)
    for _ in range(MOVES_MAX - OF_ONE_MAX):
        slots.take(others)
    with pytest.raises(Overloaded, match=f"{MOVES_MAX} channels move to host h1 already"):
        slots.check(others)
    slots.give_back(mine)
    slots.take(mine)


@pytest.mark.parametrize("creator", ["", "@cluster"])
def test_channels_whose_creator_has_no_name_of_its_own_may_use_all_moves(creator: str) -> None:
    slots, one = MoveSlots("to host h1"), replace(MADE, created_by=creator)
    for _ in range(MOVES_MAX):
        slots.take(one)
    with pytest.raises(Overloaded, match=f"{MOVES_MAX} channels move"):
        slots.take(one)


def test_fewer_queues_than_channels_move_at_the_same_time() -> None:
    slots = MoveSlots("to host h1", of_queues=True)
    for _ in range(QUEUE_MOVES_MAX):
        slots.take(MADE)
    assert slots.under_way == QUEUE_MOVES_MAX
    with pytest.raises(Overloaded, match="8 queues move to host h1 already"):
        slots.check(MADE)
