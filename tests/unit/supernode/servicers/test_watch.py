"""Watches of the directory, over gRPC."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio

from stampede_rt.v1 import directory_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_supernode.core import change_ring
from stampede_rt_supernode.servicers import calls, watch
from tests.support.supernode.node import Node, reason_of, running_node, spec


@pytest_asyncio.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        await node.register(1, name="one")
        yield node


def begin(node: Node, **fields: Any) -> Any:
    return node.stub.Watch(pb.WatchRequest(**fields))


async def changes(stream: Any, count: int) -> list[tuple[int, str]]:
    seen: list[tuple[int, str]] = []
    while len(seen) < count:
        response = await stream.read()
        for change in response.changes:
            seen.append((change.kind, getattr(change, change.WhichOneof("subject")).name))
    return seen


ADDED, UPDATED, REMOVED = (
    directory_pb2.CHANGE_KIND_ADDED,
    directory_pb2.CHANGE_KIND_UPDATED,
    directory_pb2.CHANGE_KIND_REMOVED,
)


async def test_the_first_response_has_the_start_of_the_watch_and_changes_follow(node: Node) -> None:
    await node.open("before")
    stream = begin(node)
    first = await stream.read()
    assert (list(first.changes), first.applied_index) == ([], node.log.index)
    opened = await node.open("cam")
    await node.open("cam", spec=spec(max_items=1))
    await node.stub.DeleteChannel(pb.DeleteChannelRequest(request_id=bytes(16), channel_id=opened.channel.channel_id))
    assert await changes(stream, 3) == [(ADDED, "cam"), (UPDATED, "cam"), (REMOVED, "cam")]
    stream.cancel()


async def test_a_watch_waits_for_the_turn_of_its_caller_before_it_looks_for_changes(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    class BeyondItsShare:
        must_wait = True
        waiting, arrival = asyncio.Event(), asyncio.Event()

        async def turn(self) -> None:
            self.waiting.set()
            await self.arrival.wait()
            self.must_wait = False

    work = BeyondItsShare()
    monkeypatch.setattr(watch, "current_work", lambda: work)
    stream = begin(node)
    await stream.read()
    await work.waiting.wait()
    await node.open("cam")
    work.arrival.set()
    assert await changes(stream, 1) == [(ADDED, "cam")]
    stream.cancel()


async def test_a_watch_from_an_index_brings_everything_after_it_once(node: Node) -> None:
    stream = begin(node)
    start = (await stream.read()).applied_index
    stream.cancel()
    for number in range(5):
        await node.open(f"cam/{number}")
    stream = begin(node, after_index=start + 1, name_glob="cam/*")
    assert (await stream.read()).applied_index == start + 1
    assert await changes(stream, 4) == [(ADDED, f"cam/{number}") for number in range(1, 5)]
    stream.cancel()


async def test_a_response_has_the_index_up_to_which_everything_was_sent(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch, "CHANGES_PER_RESPONSE_MAX", 2)
    for number in range(3):
        await node.open(f"cam/{number}")
    start = node.log.index
    await node.register(1, name="one", boot=2)  # one log position, three channels and the host
    await node.open("mic")
    stream = begin(node, after_index=start, include_hosts=True)
    seen = [await stream.read() for _ in range(4)]
    assert [len(response.changes) for response in seen] == [0, 2, 2, 1]
    assert [response.applied_index for response in seen] == [start, start, start + 1, start + 2]
    stream.cancel()


async def test_a_watch_filters_by_pattern_and_by_host(node: Node) -> None:
    with_hosts, without = begin(node, include_hosts=True, name_glob="mic"), begin(node, name_glob="mic")
    await with_hosts.read()
    await without.read()
    await node.open("cam")
    await node.register(2, name="two")
    await node.open("mic")
    assert await changes(with_hosts, 2) == [(ADDED, "two"), (ADDED, "mic")]
    assert await changes(without, 1) == [(ADDED, "mic")]
    with_hosts.cancel()
    without.cancel()


async def test_a_watch_from_a_dropped_or_future_index_is_refused() -> None:
    async with running_node() as node:
        node.replica.prepare_restore(node.replica.begin_snapshot()())()
        for index in (node.log.index + 1, 10**9):
            error = await reason_of(begin(node, after_index=index).read())
            assert error.reason == "WATCH_RESTART"
            assert "list again" in error.message


async def test_a_watcher_that_lags_too_far_gets_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(change_ring.ChangeRing.__init__, "__kwdefaults__", {"changes_max": 3})
    async with running_node() as node:
        await node.register(1)
        start = node.log.index
        for number in range(5):
            await node.open(f"cam/{number}")
        assert (await reason_of(begin(node, after_index=start).read())).reason == "WATCH_RESTART"


async def test_a_state_that_was_replaced_ends_the_watches_on_it(node: Node) -> None:
    stream = begin(node)
    await stream.read()
    node.replica.prepare_restore(node.replica.begin_snapshot()())()
    assert (await reason_of(stream.read())).reason == "WATCH_RESTART"


async def test_a_bad_pattern_is_refused(node: Node) -> None:
    assert (await reason_of(begin(node, name_glob="a b").read())).reason == "INVALID_ARGUMENT"


async def test_a_supernode_without_a_majority_begins_no_watch(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calls, "ANSWER_SECONDS", 60.0)  # half of the time is for the answer, on a busy machine, too
    node.log.quorum = False
    stream = node.stub.Watch(pb.WatchRequest(), timeout=2.0)
    assert (await reason_of(stream.read())).reason == "NO_QUORUM"


async def test_watches_end_when_the_supernode_stops(node: Node) -> None:
    stream = begin(node)
    await stream.read()
    node.watches.close()
    assert (await reason_of(stream.read())).reason == "SHUTTING_DOWN"


async def test_a_watch_has_signs_of_life_while_a_leader_is_known() -> None:
    async with running_node(sign_of_life_seconds=0.02) as node:
        stream = begin(node)
        for _ in range(3):
            response = await stream.read()
            assert (list(response.changes), response.applied_index) == ([], node.log.index)
        node.log.leader_id = None
        error = await reason_of(_until_it_ends(stream))
        assert error.reason == "NO_QUORUM"
        assert "knows no leader" in error.message


async def test_a_watch_has_signs_of_life_although_unrelated_commits_wake_it() -> None:
    async with running_node(sign_of_life_seconds=0.02) as node:
        stream = begin(node, name_glob="mic")

        async def wake_without_end() -> None:
            while True:
                node.watches._bell.ring()
                await asyncio.sleep(0)

        waking = asyncio.ensure_future(wake_without_end())
        async with asyncio.timeout(20):
            for _ in range(3):
                assert not (await stream.read()).changes
        waking.cancel()
        stream.cancel()


async def _until_it_ends(stream: Any) -> None:
    while response := await stream.read():
        assert not response.changes


async def until_idle(counted: list[int]) -> list[int]:
    """The number of additions to `counted` in each turn of the event loop, until a hundred turns have added nothing."""
    added, idle = [], 0
    while idle < 100:
        before = len(counted)
        await asyncio.sleep(0)
        idle = 0 if len(counted) > before else idle + 1
        added.append(len(counted) - before)
    return added


async def test_a_change_is_reported_to_a_few_watches_in_each_turn_and_to_all_of_them(node: Node) -> None:
    """In an earlier version, one turn of the event loop woke all watches. 4096 watches took 52 ms."""
    versions: list[int] = []

    async def follow(number: int) -> None:
        async for batch in node.watches.follow("", 0, include_hosts=False):
            versions.extend(number for _ in batch.changes)

    watching = [asyncio.create_task(follow(number)) for number in range(100)]
    await until_idle(versions)
    await node.open("cam")
    per_turn = await until_idle(versions)
    await node.open("mic")
    assert max(per_turn + await until_idle(versions)) <= watch.WATCHES_PER_TURN
    assert sorted(versions) == sorted([*range(100)] * 2)
    for task in watching:
        task.cancel()
    await asyncio.gather(*watching, return_exceptions=True)


async def test_a_watch_that_lags_far_reads_one_page_of_changes_in_a_turn(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch, "CHANGES_PER_RESPONSE_MAX", 2)
    start = node.log.index
    for number in range(20):
        await node.open(f"cam/{number}")
    turn = 0
    turns_with_pages: list[int] = []
    begun = asyncio.Event()
    read = change_ring.ChangeRing.read

    def counted(ring: change_ring.ChangeRing, position: int, changes_max: int) -> change_ring.ChangePage | None:
        turns_with_pages.append(turn)
        begun.set()
        return read(ring, position, changes_max)

    async def count_turns() -> None:
        nonlocal turn
        while True:
            turn += 1
            await asyncio.sleep(0)

    monkeypatch.setattr(change_ring.ChangeRing, "read", counted)
    counting = asyncio.create_task(count_turns())
    stream = begin(node, after_index=start, name_glob="mic")
    await stream.read()
    await begun.wait()
    await until_idle(turns_with_pages)
    counting.cancel()
    assert (len(turns_with_pages), len(set(turns_with_pages))) == (11, 11)
    await node.open("mic")
    assert await changes(stream, 1) == [(ADDED, "mic")]
    stream.cancel()
