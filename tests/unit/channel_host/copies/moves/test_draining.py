"""The drain of a host: which other host gets a channel if the one that the drain asks first has no room, or stops."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AsyncExitStack
from types import SimpleNamespace
from typing import Any

import grpc
import pytest

from stampede_rt.errors import (
    ChannelNotFound,
    HostNotFound,
    InvalidArgument,
    LeaseExpired,
    Overloaded,
    PermissionDenied,
    StaleBinding,
    StampedeError,
)
from stampede_rt.status import to_error_message
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import migration_service_pb2_grpc
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.refusals import SHUTTING_DOWN
from stampede_rt_channel_host.copies.moves import draining
from stampede_rt_channel_host.copies.moves.draining import DrainResult, HostDrain
from stampede_rt_channel_host.core.placing import OtherHost
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_runtime.server import serving

SECONDS_MAX = 60.0
FULL = Overloaded("the host has no room")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draining, "RETRY_SECONDS_MIN", 0.001)


class Host(migration_service_pb2_grpc.MigrationServiceServicer):
    """A host that refuses the first channels with `errors`, and takes the others. `always`: it refuses all."""

    def __init__(
        self, *errors: StampedeError, always: StampedeError | None = None, is_frozen: bool = False,
        has_archive: bool = False, is_older: bool = False, breaks: int = 0,
    ) -> None:  # fmt: skip
        """`is_older`: the host has no MoveEachHere. `breaks`: this many streams break at their first request."""
        self.is_older, self.breaks, self.streams = is_older, breaks, 0
        self.errors, self.always, self.is_frozen, self.has_archive = [*errors], always, is_frozen, has_archive
        self.taken: list[bytes] = []
        self.is_allowed: Callable[[bytes], bool] = lambda channel_id: False
        self.has_begun = asyncio.Event()

    def add_to(self, server: grpc.aio.Server) -> None:
        migration_service_pb2_grpc.add_MigrationServiceServicer_to_server(self, server)

    @errors_as_status
    async def DrainHost(self, request: pb.DrainHostRequest, context: Context) -> pb.DrainHostResponse:  # noqa: N802
        raise InvalidArgument("nobody asks for this")

    @errors_as_status
    async def MoveHere(self, request: pb.MoveHereRequest, context: Context) -> pb.MoveHereResponse:  # noqa: N802
        assert self.is_older or request.queue_id, "the drain has asked for the channel in its stream"
        await self._take(request.channel_id)
        return pb.MoveHereResponse()

    async def _take(self, channel_id: bytes) -> None:
        self.has_begun.set()
        if self.is_frozen:
            await asyncio.get_running_loop().create_future()
        if self.always is not None or self.errors:
            raise self.always or self.errors.pop(0)
        assert self.is_allowed(channel_id), "the drain has allowed its own move first"
        self.taken.append(channel_id)

    @errors_as_status
    async def MoveEachHere(self, requests: Any, context: Context) -> None:  # type: ignore[override]  # noqa: N802
        if self.is_older:
            await context.abort(grpc.StatusCode.UNIMPLEMENTED, "Method not found!")
        self.streams += 1
        while isinstance(request := await context.read(), pb.MoveEachHereRequest):
            if self.breaks:
                self.breaks -= 1
                raise Overloaded("the stream breaks")
            for channel_id in request.channel_ids:
                outcome = pb.MoveOutcome(channel_id=channel_id)
                try:
                    await self._take(channel_id)
                except StampedeError as error:
                    outcome.error.CopyFrom(to_error_message(error))
                await context.write(pb.MoveEachHereResponse(outcomes=[outcome]))


async def drained(
    channels: int, *hosts: Host, recorded: bool = False, name: str = "cam/{}", held: int = 1, is_last: bool = False,
    arriving: int = 0,
) -> DrainResult:  # fmt: skip
    """Drain `channels` channels without groups, with `held` items each, to these hosts. Returns the outcome.

    `arriving`: the number of further channels, whose moves to this host end during the drain.
    """
    async with AsyncExitStack() as servers:
        others: list[OtherHost] = []
        for number, host in enumerate(hosts):
            server = await servers.enter_async_context(serving(host.add_to))
            others.append(OtherHost(b"%d" % number, f"h{number}", server.address, 0, number, host.has_archive))

        async def other_hosts() -> list[OtherHost]:
            return others

        policy = Policy(archive_nanos=1) if recorded else Policy()
        records = [
            SimpleNamespace(channel_id=b"c%d" % one, name=name.format(one), policy=policy)
            for one in range(channels + arriving)
        ]
        core = SimpleNamespace(latest_counters=lambda: SimpleNamespace(held=held))
        later = [
            SimpleNamespace(record=one, copy=None, is_fallback=False, epoch=1, moving=None, core=core)
            for one in records
        ]
        own, later = later[:channels], later[channels:]

        async def arrived() -> None:
            await asyncio.sleep(0)
            own.extend(later)

        allowed: set[tuple[bytes, bytes]] = set()
        for number, host in enumerate(hosts):
            host.is_allowed = lambda channel_id, at=b"%d" % number: (channel_id, at) in allowed

        def allow(channel_id: bytes, epoch: int, host_id: bytes) -> None:
            allowed.add((channel_id, host_id))

        store: Any = SimpleNamespace(all=lambda: own, serves=lambda hosted: True)
        directory: Any = SimpleNamespace(other_hosts=other_hosts)
        queues: Any = SimpleNamespace(all=list)
        dial = grpc.aio.insecure_channel
        drain = HostDrain(store, queues, directory, lambda channel_id: [], dial, dial, allow)
        return await drain.run(SECONDS_MAX, arrivals=(arrived,) if is_last else ())


async def test_a_drained_channel_goes_to_another_host_if_the_first_has_no_room() -> None:
    full, free = Host(always=FULL), Host()
    assert await drained(3, full, free) == DrainResult(3, {})
    assert sorted(free.taken) == [b"c0", b"c1", b"c2"]


async def test_a_drain_asks_a_host_with_too_many_moves_again_later() -> None:
    busy = Host(*[FULL] * 5)
    assert await drained(3, busy) == DrainResult(3, {})
    assert sorted(busy.taken) == [b"c0", b"c1", b"c2"]


@pytest.mark.parametrize(
    "error",
    [
        StaleBinding("channel c0 is at epoch 2, not 1", reason="WRONG_EPOCH"),
        PermissionDenied("no caller has asked this host", metadata={"host_id": "00"}),
    ],
)
async def test_a_drain_asks_again_if_its_host_has_ended_a_move_or_has_another_epoch(error: StampedeError) -> None:
    """In an earlier version, the drain gave a channel up after the link to the other host had broken."""
    host = Host(error)
    assert await drained(1, host) == DrainResult(1, {})
    assert host.taken == [b"c0"]


@pytest.mark.parametrize("error", [HostNotFound("its lease has ended"), LeaseExpired("it has registered again")])
async def test_a_channel_goes_to_another_host_if_the_first_has_lost_its_lease_during_the_move(
    error: StampedeError,
) -> None:
    first, other = Host(always=error), Host()
    assert await drained(1, first, other) == DrainResult(1, {})
    assert other.taken == [b"c0"]


async def test_a_drain_ends_if_all_other_hosts_are_silent_and_lets_its_host_do_other_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, the drain went from one host to the other for ever, without a pause."""
    monkeypatch.setattr(draining, "BEGIN_SECONDS_MAX", 0.01)
    monkeypatch.setattr("tests.unit.channel_host.copies.moves.test_draining.SECONDS_MAX", 1.0)
    left = (await drained(1, Host(is_frozen=True), Host(is_frozen=True))).unmoved
    assert [*left] == ["cam/0"]


async def test_a_cancelled_drain_logs_the_channels_that_have_not_moved(caplog: pytest.LogCaptureFixture) -> None:
    """In an earlier version, a host that got a second signal lost its channels without a line in the log."""
    frozen = Host(is_frozen=True)
    draining_task = asyncio.create_task(drained(3, frozen, is_last=True))
    async with asyncio.timeout(20):
        await frozen.has_begun.wait()
    draining_task.cancel()
    await asyncio.wait({draining_task})
    assert draining_task.cancelled()
    assert caplog.messages == [
        "3 channels could not move to another host (the drain ended before the move); the host stops, and items that "
        "no other host has are lost"
    ]


async def test_a_drain_leaves_a_channel_that_no_host_may_take() -> None:
    host = Host(always=PermissionDenied("a rule denies it"))
    assert await drained(1, host) == DrainResult(0, {"cam/0": "a rule denies it"})


async def test_all_channels_of_a_drain_are_named_in_one_stream() -> None:
    host = Host()
    assert await drained(40, host) == DrainResult(40, {})
    assert host.streams == 1


async def test_a_drain_calls_a_host_of_an_older_release_for_each_channel() -> None:
    older, full = Host(is_older=True), Host(always=FULL)
    assert await drained(5, older, full) == DrainResult(5, {})
    assert sorted(older.taken) == [b"c0", b"c1", b"c2", b"c3", b"c4"]


async def test_a_drain_whose_stream_breaks_opens_another_one() -> None:
    host = Host(breaks=2)
    assert await drained(5, host) == DrainResult(5, {})
    assert host.streams == 3


async def test_a_recorded_channel_is_drained_only_to_a_host_with_an_archive() -> None:
    plain, archiving = Host(), Host(has_archive=True)
    assert await drained(3, plain, archiving, recorded=True) == DrainResult(3, {})
    assert (len(plain.taken), len(archiving.taken)) == (0, 3)
    moved, left = await drained(1, Host(), recorded=True)
    assert (moved, [*left.values()]) == (0, ["it is recorded (archive), and no other live host has an archive"])


async def test_a_drain_moves_no_channel_to_a_host_that_also_stops() -> None:
    stopping, free = Host(always=SHUTTING_DOWN), Host()
    assert await drained(3, stopping, free) == DrainResult(3, {})
    assert len(free.taken) == 3


async def test_a_frozen_host_delays_no_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draining, "BEGIN_SECONDS_MAX", 1.0)  # on a busy machine a host that runs needs some time
    frozen, free = Host(is_frozen=True), Host()
    assert await drained(20, frozen, free) == DrainResult(20, {})
    assert len({*free.taken}) == 20  # the drain may repeat a call that was late on a busy machine


async def test_a_drain_ends_immediately_if_all_hosts_stop() -> None:
    moved, left = await drained(2, Host(always=SHUTTING_DOWN), Host(always=SHUTTING_DOWN))
    assert moved == 0
    assert set(left) == {"cam/0", "cam/1"}
    assert "shutting down" in left["cam/0"]


async def test_a_drain_reports_a_channel_that_cannot_move_but_not_a_deleted_one() -> None:
    host = Host(InvalidArgument("it is recorded"), ChannelNotFound("it is gone"))
    moved, left = await drained(2, host)
    assert (moved, len(left)) == (1, 1)
    assert "it is recorded" in next(iter(left.values()))


async def test_two_channels_with_the_same_name_are_both_drained() -> None:
    host = Host()
    assert await drained(2, host, name="cam") == DrainResult(2, {})
    assert sorted(host.taken) == [b"c0", b"c1"]


@pytest.mark.parametrize("channels", [0, 2])
async def test_the_drain_of_a_stopping_host_also_moves_the_channels_that_arrive_meanwhile(channels: int) -> None:
    """In an earlier version, their items were lost with the host, although the moves to it had succeeded."""
    host = Host()
    assert await drained(channels, host, is_last=True, arriving=2) == DrainResult(channels + 2, {})
    assert sorted(host.taken) == [b"c%d" % one for one in range(channels + 2)]


async def test_the_log_names_a_channel_that_arrives_and_cannot_move(caplog: pytest.LogCaptureFixture) -> None:
    host = Host(always=PermissionDenied("a rule denies it"))
    assert [*(await drained(0, host, is_last=True, arriving=1)).unmoved] == ["cam/0"]
    assert caplog.messages[0].startswith("1 channel could not move to another host (a rule denies it); the host stops")


@pytest.mark.parametrize(
    ("state", "logged"),
    [
        (
            {"is_last": True},
            "WARNING 1 channel could not move to another host (there is no other live host); the host stops, and items "
            "that no other host has are lost",
        ),
        (
            {},
            "WARNING 1 channel could not move to another host (there is no other live host); this host keeps the items",
        ),
        (
            {"is_last": True, "recorded": True},
            "INFO 1 channel did not move to another host: the archive of this host has the items",
        ),
        ({"is_last": True, "held": 0}, ""),
    ],
)
async def test_a_drain_warns_only_of_items_that_are_lost(
    caplog: pytest.LogCaptureFixture, state: dict[str, Any], logged: str
) -> None:
    """In an earlier version, a recorded channel whose host stopped alone gave a warning, although nothing was lost."""
    caplog.set_level("INFO", draining.logger.name)
    assert [*(await drained(1, **state)).unmoved] == ["cam/0"]
    messages = [f"{one.levelname} {one.message}" for one in caplog.records]
    assert messages == [logged][: bool(logged)]
