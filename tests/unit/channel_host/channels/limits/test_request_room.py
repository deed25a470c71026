"""The memory of a host for requests that are not yet complete."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from stampede_rt.wire.request_pieces import JOINED_BYTES_MAX, REQUEST_BYTES_MAX
from stampede_rt_channel_host.channels.limits.request_room import ROOM_BYTES, RequestRoom, RequestRooms


class Uploads:
    """Requests that take room until the test ends them. `admitted`: the requests that got room, in order."""

    def __init__(self, room: RequestRoom | RequestRooms) -> None:
        self.room = room
        self.admitted: list[str] = []
        self._tasks: dict[str, asyncio.Task[None]] = {}

    async def begin(self, name: str, caller: str, wanted_bytes: int) -> None:
        self._tasks[name] = asyncio.create_task(self._take(name, caller, wanted_bytes))
        await turns()

    async def _take(self, name: str, caller: str, wanted_bytes: int) -> None:
        give_back = await self.room.take(caller, wanted_bytes)
        try:
            self.admitted.append(name)
            await asyncio.Event().wait()
        finally:
            give_back()

    async def end(self, *names: str) -> None:
        for name in names:
            self._tasks.pop(name).cancel()
        await turns()

    async def end_all(self) -> None:
        await self.end(*self._tasks)


async def turns() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


@asynccontextmanager
async def uploads(room: RequestRoom | RequestRooms | None = None) -> AsyncIterator[Uploads]:
    """Requests that share `room`; by default 100 bytes, of which one caller gets 50 at most."""
    found = Uploads(room or RequestRoom(100, 50))
    try:
        yield found
    finally:
        await found.end_all()
        assert found.room.used_bytes == 0


async def test_requests_get_room_in_the_order_of_arrival() -> None:
    async with uploads() as some:
        for number, size in enumerate((40, 40, 30, 10)):
            await some.begin(f"{number}", f"caller {number}", size)
        assert some.admitted == ["0", "1"]  # the last request does not overtake the third
        assert some.room.used_bytes == 80
        await some.end("0")
        assert some.admitted == ["0", "1", "2", "3"]


async def test_one_caller_gets_at_most_half_of_the_room_and_its_waiting_requests_do_not_block_others() -> None:
    async with uploads() as some:
        for number in range(4):
            await some.begin(f"hostile {number}", "hostile", 25)
        await some.begin("good", "good", 50)
        assert some.admitted == ["hostile 0", "hostile 1", "good"]
        await some.end("hostile 0")
        assert some.admitted == ["hostile 0", "hostile 1", "good", "hostile 2"]


async def test_a_request_of_a_vanished_caller_frees_its_bytes_and_its_place_in_line() -> None:
    async with uploads() as some:
        await some.begin("first", "a", 50)
        await some.begin("second", "b", 50)
        await some.begin("gone", "c", 50)
        await some.begin("third", "d", 50)
        await some.end("gone", "first")
        assert some.admitted == ["first", "second", "third"]


async def test_a_request_that_is_cancelled_when_it_gets_room_gives_the_room_back() -> None:
    async with uploads() as some:
        await some.begin("first", "a", 50)
        await some.begin("second", "a", 50)
        some._tasks["first"].cancel()
        await asyncio.sleep(0)
        await some.end("second")
        assert some.room.used_bytes == 0
        some._tasks.pop("first")


async def test_unfinished_large_requests_leave_room_for_the_requests_of_producers() -> None:
    async with uploads(RequestRooms()) as some:
        for number in range(12):
            await some.begin(f"large {number}", f"hostile {number % 3}", REQUEST_BYTES_MAX)
        assert len(some.admitted) == 3, "as many requests as fit into one half of the room"
        for number in range(40):
            await some.begin(f"joined {number}", "good", JOINED_BYTES_MAX)
        assert len(some.admitted) == 3 + 32, "one caller gets half of the other half of the room"
        assert some.room.used_bytes <= ROOM_BYTES


class CountedBytes(int):
    """The size of a request. Counts the comparisons with the free room."""

    comparisons = 0

    def __radd__(self, other: int) -> int:
        type(self).comparisons += 1
        return int(self) + other


async def test_waiting_requests_of_a_caller_at_its_limit_cost_other_requests_no_steps() -> None:
    async with uploads() as some:
        for number in range(1000):
            await some.begin(f"hostile {number}", "hostile", CountedBytes(25))
        CountedBytes.comparisons = 0
        for number in range(100):
            await some.begin(f"good {number}", "good", CountedBytes(25))
            await some.end(f"good {number}")
        assert CountedBytes.comparisons <= 100 * 6, "a few for each good request, and none for the 998 that wait"
        assert some.admitted[-1] == "good 99"


async def test_waiting_requests_of_vanished_callers_are_removed() -> None:
    async with uploads() as some:
        await some.begin("first", "a", 50)
        for number in range(100):
            await some.begin(f"gone {number}", "a", 50)
            await some.end(f"gone {number}")
        [line] = some.room._lines.values()
        assert not line.waiting
        await some.end("first")
        assert (some.room._lines, some.room._listed) == ({}, [])
