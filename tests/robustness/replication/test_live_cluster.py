"""Three members over real gRPC with real stores: they serve, lose one member, catch up, and refuse strangers."""

from __future__ import annotations

import asyncio
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import grpc
import grpc.aio
import pytest

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication import (
    COMMAND_BYTES_MAX,
    LogUnavailable,
    Member,
    OutcomeUnknown,
    RaftTiming,
    ReplicationSettings,
    open_replicated_log,
)
from tests.support.supernode import live_cluster
from tests.support.supernode.list_machine import ListMachine
from tests.support.supernode.live_cluster import QUICK, LiveCluster, commands_of, dial, proposed, running, until

SECONDS_MAX = 30.0
EXCHANGE = "/stampede_rt.v1.RaftService/Exchange"


async def test_one_member_alone_commits_immediately(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path, timing=RaftTiming()) as cluster:
        [member] = cluster.all
        assert await running(member).propose(b"hello", timeout=SECONDS_MAX) == b"3"
        assert await running(member).confirm_read(timeout=SECONDS_MAX) == 3


async def test_a_member_without_a_folder_serves_from_memory() -> None:
    async with LiveCluster(1, None) as cluster:
        assert await running(cluster.all[0]).propose(b"hello", timeout=SECONDS_MAX) == b"3"


async def test_with_the_default_periods_a_new_cluster_serves(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path, timing=RaftTiming()) as cluster:
        assert int(await proposed(cluster.all[0], b"hello")) > 1


async def test_every_member_takes_commands_and_sees_all_of_them(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        for number, member in enumerate(cluster.all * 3):
            await proposed(member, b"command %d" % number)
        for member in cluster.all:
            index = await running(member).confirm_read(timeout=SECONDS_MAX)
            assert member.machine.entries[-1][0] == index
            assert commands_of(member) == [b"command %d" % n for n in range(9)]


async def test_the_leader_knows_its_tenure_and_the_others_have_none(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        status = running(await cluster.leader()).status()
        assert status.tenure == status.term > 0
        for follower in await cluster.followers():
            assert running(follower).status().tenure == 0


@pytest.mark.parametrize("who", ["leader", "follower"])
async def test_a_restarted_member_catches_up_from_its_disk(tmp_path: Path, who: str) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        await proposed(cluster.all[0], b"before")
        lost = await cluster.leader() if who == "leader" else (await cluster.followers())[0]
        await lost.stop()
        survivor = next(each for each in cluster.all if each.log)
        await proposed(survivor, b"meanwhile")
        await cluster.start(lost)
        await proposed(lost, b"after")
        assert commands_of(lost) == [b"before", b"meanwhile", b"after"]


async def test_a_member_that_missed_much_catches_up_by_snapshot(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path, snapshot_every=20) as cluster:
        lost = (await cluster.followers())[0]
        await lost.stop()
        leader = await cluster.leader()
        await asyncio.gather(*(proposed(leader, b"command %d" % n) for n in range(60)))
        await cluster.start(lost)
        index = await running(lost).confirm_read(timeout=SECONDS_MAX)
        assert lost.machine.entries[-1][0] == index
        assert len(commands_of(lost)) == 60


async def test_a_cluster_without_a_majority_acknowledges_nothing(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        first, second, third = cluster.all
        await proposed(first, b"before")
        await second.stop()
        await third.stop()
        await until(lambda: running(first).status().leader_id is None)
        with pytest.raises(LogUnavailable):
            await running(first).propose(b"alone", timeout=0.3)
        with pytest.raises(LogUnavailable):
            await running(first).confirm_read(timeout=0.3)


async def test_a_cluster_that_was_stopped_completely_still_has_all_acknowledged_commands(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        await asyncio.gather(*(proposed(cluster.all[n % 3], b"%d" % n) for n in range(30)))
        for member in cluster.all:
            await member.stop()
        for member in cluster.all:
            await cluster.start(member)
        await running(cluster.all[0]).confirm_read(timeout=SECONDS_MAX)
        assert {command for _, command in cluster.all[0].machine.entries} == {b"%d" % n for n in range(30)}


async def test_a_command_over_the_limit_is_refused_by_name_and_size(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path) as cluster:
        log = running(cluster.all[0])
        assert await log.propose(b"x" * COMMAND_BYTES_MAX, timeout=SECONDS_MAX)
        with pytest.raises(ValueError, match="65537 bytes is over the limit of 65536"):
            await log.propose(b"x" * (COMMAND_BYTES_MAX + 1), timeout=SECONDS_MAX)


async def test_closing_ends_all_waiting_calls_immediately(tmp_path: Path) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        first, second, third = cluster.all
        await second.stop()
        await third.stop()
        await until(lambda: running(first).status().leader_id is None)
        log = running(first)
        waiting = [
            asyncio.ensure_future(log.propose(b"never", timeout=60.0)),
            asyncio.ensure_future(log.confirm_read(timeout=60.0)),
        ]
        await asyncio.sleep(0)
        async with asyncio.timeout(SECONDS_MAX):
            await log.close()
            for each in waiting:
                with pytest.raises(LogUnavailable):
                    await each


async def test_a_failure_in_the_state_machine_is_fatal_and_never_answered(tmp_path: Path) -> None:
    class Broken(ListMachine):
        def apply(self, index: int, command: bytes) -> bytes:
            raise ZeroDivisionError("a state machine must not raise")

    failed = asyncio.get_running_loop().create_future()
    loop = asyncio.get_running_loop()
    server = grpc.aio.server()
    address = f"127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    member = Member(member_id="m0", address=address)
    log = await open_replicated_log(
        ReplicationSettings(self_member=member, initial_members=[member]),
        Broken(),
        dial,
        server,
        on_fatal=lambda error: loop.call_soon_threadsafe(failed.set_result, error),
    )
    with pytest.raises(OutcomeUnknown):
        await log.propose(b"boom", timeout=0.5)
    assert isinstance(await failed, ZeroDivisionError)
    await log.close()


async def test_a_closed_log_refuses_and_closing_twice_is_harmless(tmp_path: Path) -> None:
    async with LiveCluster(1, tmp_path) as cluster:
        log = running(cluster.all[0])
        await log.close()
        await log.close()
        with pytest.raises(LogUnavailable, match="closed"):
            await log.propose(b"late", timeout=SECONDS_MAX)


# -- strangers at the port ---------------------------------------------------------------------------------------

EXECUTED: list[str] = []


def execute(what: str) -> None:
    EXECUTED.append(what)


class CodePickle:
    """A pickle that runs code when a program loads it."""

    def __reduce__(self) -> tuple[Any, ...]:
        return execute, ("unpickled",)


def hello(**changes: Any) -> pb.RaftServiceExchangeRequest:
    fields = {"member_id": "m1", "peer_member_id": "m0", "protocol_version": 2, "highest_feature_level": 1} | changes
    return pb.RaftServiceExchangeRequest(hello=pb.RaftHello(**fields))


async def refusal(address: str, *requests: bytes) -> grpc.StatusCode:
    """Send raw requests on a stream. Returns the status with which the member ended it."""
    channel = dial(address)
    try:
        call = channel.stream_stream(EXCHANGE)()
        try:
            for request in requests:
                await call.write(request)
            while await call.read() is not grpc.aio.EOF:
                pass
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
            pass
        return await call.code()
    finally:
        await channel.close()


async def test_pickles_and_random_bytes_at_the_port_execute_nothing(tmp_path: Path) -> None:
    EXECUTED.clear()
    bomb = pickle.dumps(CodePickle())
    command = pb.RaftMessage(forwarded_command=pb.RaftForwardedCommand(request_id=1, command=b"\x00" + bomb))
    async with LiveCluster(1, tmp_path) as cluster:
        [member] = cluster.all
        before = await running(member).propose(b"before", timeout=SECONDS_MAX)
        for raw in (bomb, b"\x80\x04garbage", bytes(range(256)), b""):
            assert await refusal(member.member.address, raw) != grpc.StatusCode.OK
        reader, writer = await asyncio.open_connection("127.0.0.1", member.port)
        writer.write(bomb * 20)
        await writer.drain()
        await reader.read()
        writer.close()
        stream = pb.RaftServiceExchangeRequest(messages=[command]).SerializeToString()
        assert await refusal(member.member.address, hello().SerializeToString(), stream) != grpc.StatusCode.OK
        after = await running(member).propose(bomb, timeout=SECONDS_MAX)
        assert int(after) == int(before) + 1
    assert EXECUTED == []
    pickle.loads(bomb)
    assert EXECUTED == ["unpickled"]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"member_id": "stranger"}, grpc.StatusCode.PERMISSION_DENIED),
        ({"member_id": "m0"}, grpc.StatusCode.PERMISSION_DENIED),
        ({"peer_member_id": "m2"}, grpc.StatusCode.FAILED_PRECONDITION),
        ({"cluster_id": "other"}, grpc.StatusCode.FAILED_PRECONDITION),
        ({"highest_feature_level": 0}, grpc.StatusCode.FAILED_PRECONDITION),
        ({"protocol_version": 1}, grpc.StatusCode.FAILED_PRECONDITION),
    ],
)
async def test_a_stream_with_a_wrong_hello_is_refused(
    tmp_path: Path, changes: dict[str, Any], code: grpc.StatusCode
) -> None:
    async with LiveCluster(3, tmp_path) as cluster:
        assert await refusal(cluster.all[0].member.address, hello(**changes).SerializeToString()) == code


async def test_a_malformed_message_ends_the_stream_and_not_the_member() -> None:
    async with LiveCluster(3, None) as cluster:
        empty = pb.RaftServiceExchangeRequest(messages=[pb.RaftMessage()])
        first = hello().SerializeToString()
        code = await refusal(cluster.all[0].member.address, first, empty.SerializeToString())
        assert code == grpc.StatusCode.INVALID_ARGUMENT
        assert int(await proposed(cluster.all[0], b"still here")) > 1


async def test_a_replica_logs_once_why_it_has_no_link(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    attempts: list[str] = []
    monkeypatch.setattr(live_cluster, "dial", lambda address: attempts.append(address) or dial(address))
    async with LiveCluster(1, tmp_path) as cluster:
        [member] = cluster.all
        cluster.members.append(Member(member_id="m9", address=member.member.address))
        await member.stop()
        await cluster.start(member)
        await until(lambda: len(attempts) >= 4)
        assert len([text for text in caplog.messages if "this is member 'm0'" in text]) == 1


class SilentMember:
    """A member that accepts every stream, reads it, and answers nothing."""

    def __init__(self) -> None:
        self.streams = 0
        self.second_stream = asyncio.Event()

    async def exchange(self, request_iterator: Any, context: Any) -> None:
        self.streams += 1
        if self.streams == 2:
            self.second_stream.set()
        await context.read()
        await context.write(pb.RaftServiceExchangeResponse(protocol_version=1))
        while await context.read() is not grpc.aio.EOF:
            pass


async def test_a_link_without_answers_is_replaced(tmp_path: Path) -> None:
    silent, server = SilentMember(), grpc.aio.server()
    handler = grpc.stream_stream_rpc_method_handler(
        silent.exchange,
        request_deserializer=pb.RaftServiceExchangeRequest.FromString,
        response_serializer=pb.RaftServiceExchangeResponse.SerializeToString,
    )
    server.add_generic_rpc_handlers(
        (grpc.method_handlers_generic_handler("stampede_rt.v1.RaftService", {"Exchange": handler}),)
    )
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    impatient = replace(QUICK, link_silence_seconds=0.2)
    async with LiveCluster(1, tmp_path, timing=impatient) as cluster:
        cluster.members.append(Member(member_id="silent", address=f"127.0.0.1:{port}"))
        await cluster.all[0].stop()
        await cluster.start(cluster.all[0])
        async with asyncio.timeout(SECONDS_MAX):
            await silent.second_stream.wait()
    await server.stop(None)


async def test_links_that_are_answered_stay_up(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="stampede_rt_supernode.replication.network.peer_link")
    async with LiveCluster(3, tmp_path, timing=replace(QUICK, link_silence_seconds=1.0)) as cluster:
        leader = await cluster.leader()
        loop = asyncio.get_running_loop()
        end, writes = loop.time() + 1.5, 0
        while loop.time() < end:
            await proposed(leader, b"write %d" % writes)
            writes += 1
        assert "nothing was answered" not in caplog.text
