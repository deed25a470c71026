"""The moves that one call to the directory states: each has its own outcome, and waits for no other move."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import ChannelNotFound, StaleBinding
from stampede_rt_channel_host.copies.moves.gathered_moves import FallbackRelease, GatheredMoves, MoveCommit


class Directory(GatheredMoves):
    """Commits no moves in one call. Refuses each single move once all of them have been asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.begun, self.all_begun = 0, asyncio.Event()
        self.lookups: list[list[bytes]] = []

    async def owner_of_one(self, channel_id: bytes) -> Any:
        return (await self.owners_of([channel_id]))[0]

    async def owners_of(self, channel_ids: Sequence[bytes]) -> Sequence[Any]:
        """Knows all channels but `gone`."""
        self.lookups.append([*channel_ids])
        return [(SimpleNamespace(channel_id=one), "owner") for one in channel_ids if one != b"gone"]

    async def commit_one(self, move: MoveCommit) -> Any:
        self.begun += 1
        if self.begun == 4:
            self.all_begun.set()
        if self.begun > 1:
            await self.all_begun.wait()
        raise StaleBinding(f"no {move.channel_id.decode()}", reason="WRONG_EPOCH")

    async def commit_all(self, moves: Sequence[MoveCommit]) -> Sequence[Any]:
        return []

    async def release_all(self, moves: Sequence[FallbackRelease]) -> set[bytes]:
        raise NotImplementedError

    async def released_of(self, channel_ids: Sequence[bytes]) -> set[bytes]:
        raise NotImplementedError


async def test_the_reasons_of_several_refused_moves_are_asked_for_at_the_same_time() -> None:
    directory = Directory()
    moves = [asyncio.create_task(directory.commit(name, 1, b"", b"permit")) for name in (b"a", b"b", b"c", b"d")]
    async with asyncio.timeout(10):
        for name, move in zip("abcd", moves, strict=True):
            with pytest.raises(StaleBinding, match=f"no {name}"):
                await move


async def test_moves_that_begin_at_the_same_time_ask_for_their_owners_together() -> None:
    directory = Directory()
    asking = [asyncio.create_task(directory.owner_of(name)) for name in (b"a", b"gone", b"c")]
    async with asyncio.timeout(10):
        await asyncio.wait(asking)
    assert directory.lookups == [[b"a", b"gone", b"c"]]
    assert asking[0].result()[0].channel_id == b"a"
    assert asking[2].result()[0].channel_id == b"c"
    with pytest.raises(ChannelNotFound, match=b"gone".hex()):
        asking[1].result()


async def test_a_single_move_asks_for_one_owner_only() -> None:
    directory = Directory()
    found: Any = await directory.owner_of(b"a")
    assert (found[0].channel_id, directory.lookups) == (b"a", [[b"a"]])
