"""Two moves of the same channel or queue at the same time, between real processes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.cli.commands import run
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

ITEM_BYTES = 2**20
ITEMS = 16  # more than the source sends before the other host grants more credit


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    """Hosts that take the copy of a channel so slowly that its move is under way until the channel is deleted."""
    planned = LocalCluster(hosts=3, supernodes=1)
    for host in planned.hosts:
        host.arguments += ["--copy-bytes-per-second", "1"]
    with running_cluster(planned) as made:
        yield made


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


@pytest.fixture
def moving_channel(rt: Any) -> Iterator[Any]:
    """A channel whose move to h2 is under way until the test has ended."""
    channel = rt.channel("cam", max_items=100, host="h1")
    for _ in range(ITEMS):
        channel.put(bytes(ITEM_BYTES))
    failures: list[Exception] = []
    moving = threading.Thread(target=_note_failure, args=(lambda: rt.move(channel, "h2"), failures), daemon=True)
    moving.start()
    wait_until(lambda: "cam" in rt.hosted_channels("h2"), "the copy has begun")
    yield channel
    channel.delete()
    moving.join(20)
    assert len(failures) == 1


def _note_failure(call: Callable[[], object], failures: list[Exception]) -> None:
    try:
        call()
    except Exception as error:  # noqa: BLE001 - the test checks the failures
        failures.append(error)


def test_a_move_of_a_channel_that_moves_to_another_host_is_a_conflict(
    rt: Any, moving_channel: Any, cluster: LocalCluster, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(st.MoveConflict, match="another move of channel cam is under way") as refused:
        rt.move(moving_channel, "h3")
    assert (refused.value.reason, refused.value.metadata["channel"]) == ("MOVE_CONFLICT", "cam")
    assert run(["move", "cam", "h3", "--url", cluster.address]) == 1
    assert capsys.readouterr().err == "stampede: another move of channel cam is under way; wait until it is over\n"


async def test_a_second_move_is_a_conflict_for_callers_with_asyncio_too(
    moving_channel: Any, cluster: LocalCluster
) -> None:
    async with aio.connect(cluster.address, transport="grpc") as rt:
        with pytest.raises(st.MoveConflict, match="another move of channel cam is under way"):
            await rt.move("cam", "h3")


def test_a_queue_performs_two_moves_that_begin_at_the_same_time(rt: Any) -> None:
    queue = rt.queue("jobs", host="h1")
    queue.put(b"x")
    failures: list[Exception] = []
    moves = [
        threading.Thread(target=_note_failure, args=(lambda host=host: rt.move_queue("jobs", host), failures))  # type: ignore[misc]
        for host in ("h2", "h3")
    ]
    for move in moves:
        move.start()
    for move in moves:
        move.join(30)
    assert failures == []
    assert rt.queues("jobs")[0].host in ("h2", "h3")
    assert queue.get(timeout=5).payload == b"x"
