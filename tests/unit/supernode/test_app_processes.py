"""Real supernode processes: started, killed, restarted."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from pathlib import Path

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_supernode.app import main
from tests.support.supernode.processes import (
    Cluster,
    Supernode,
    attempts,
    called,
    free_ports,
    open_channel,
    register,
    renew,
    resolve,
    running_cluster,
)


async def test_a_single_supernode_serves_on_a_free_port_and_stops_with_code_0() -> None:
    address = f"127.0.0.1:{free_ports(1)[0]}"
    one = Supernode("supernode-1", address, ["--listen", address])
    try:
        assert await one.start() == f"stampede supernode supernode-1 ready on {address}"
        health = health_pb2_grpc.HealthStub(one.channel)
        async for _ in attempts():
            if (await health.Check(health_pb2.HealthCheckRequest())).status == health_pb2.HealthCheckResponse.SERVING:
                break
        await register(one, 1)
        await open_channel(one, "cam")
        watch = one.stub.Watch(pb.WatchRequest())
        await watch.read()
        (code, printed), error = await asyncio.gather(one.end(signal.SIGTERM), ended_with(watch))
        assert (code, printed) == (0, b"")
        assert error == "SHUTTING_DOWN"
    finally:
        await one.close()


async def ended_with(watch: object) -> str:
    with pytest.raises(Exception, match="about to stop") as caught:
        await called(watch.read(), Supernode("x", "localhost:1", []))  # type: ignore[attr-defined]
    return str(caught.value.reason)  # type: ignore[attr-defined]


async def test_port_0_is_announced_as_the_port_that_was_bound() -> None:
    one = Supernode("supernode-1", "localhost:1", ["--listen", "localhost:0"])
    try:
        line = await one.start()
        assert line.startswith("stampede supernode supernode-1 ready on localhost:")
        assert int(line.rpartition(":")[2]) > 0
        assert (await one.end(signal.SIGINT))[0] == 0
    finally:
        await one.close()


async def test_all_members_read_acknowledged_commands_even_after_the_loss_of_the_leader(tmp_path: Path) -> None:
    async with running_cluster(tmp_path) as cluster:
        leader = await cluster.leader()
        first, second = cluster.others(leader)
        await register(first, 1)
        opened = await open_channel(first, "cam/before")
        for one in cluster.supernodes:
            assert (await resolve(one, "cam/before")).channel == opened.channel

        racers = await asyncio.gather(*(open_channel(one, "cam/raced-for") for one in cluster.supernodes))
        assert len({racer.channel.channel_id for racer in racers}) == 1
        assert [racer.created for racer in racers].count(True) == 1

        watch = second.stub.Watch(pb.WatchRequest())
        await watch.read()
        await open_channel(leader, "cam/last-words")
        await leader.end(signal.SIGKILL)
        after = await open_channel(first, "cam/after")
        assert (await resolve(second, "cam/after")).channel == after.channel
        assert (await resolve(second, "cam/before")).channel == opened.channel
        assert await names_seen(watch, 2) == ["cam/last-words", "cam/after"]

        await leader.start()
        await cluster_id_of(leader)
        assert (await resolve(leader, "cam/after")).channel == after.channel


async def cluster_id_of(supernode: Supernode) -> str:
    """The id of its cluster, once it is ready."""
    async for _ in attempts():
        with contextlib.suppress(grpc.aio.AioRpcError):
            pong = await supernode.stub.Ping(pb.DirectoryServicePingRequest(), timeout=1)
            if pong.ready:
                return str(pong.cluster_id)
    raise AssertionError("unreachable")


async def names_seen(watch: object, count: int) -> list[str]:
    seen: list[str] = []
    while len(seen) < count:
        response = await watch.read()  # type: ignore[attr-defined]
        seen += [change.channel.name for change in response.changes]
    return seen


async def test_a_crash_of_all_three_supernodes_loses_no_acknowledged_command(tmp_path: Path) -> None:
    async with running_cluster(tmp_path) as cluster:
        assert (await register(cluster.supernodes[0], 1)).cluster_id
        opened = [await open_channel(one, f"cam/{one.name}") for one in cluster.supernodes]
        cluster_id = await cluster_id_of(cluster.supernodes[0])
        await asyncio.gather(*(one.end(signal.SIGKILL) for one in cluster.supernodes))
        await cluster.start()
        for one in cluster.supernodes:
            for channel in opened:
                assert (await resolve(one, channel.channel.name)).channel == channel.channel
        assert await cluster_id_of(cluster.supernodes[1]) == cluster_id


async def test_a_frozen_leader_is_replaced_and_gives_no_stale_answers_when_it_continues(tmp_path: Path) -> None:
    async with running_cluster(tmp_path) as cluster:
        leader = await cluster.leader()
        first, second = cluster.others(leader)
        await register(first, 1)
        leader.freeze()
        opened = await open_channel(first, "cam")
        leader.thaw()
        for one in (leader, second):
            assert (await resolve(one, "cam")).channel == opened.channel


async def test_a_renewed_lease_outlives_its_leader_and_an_unrenewed_one_ends(tmp_path: Path) -> None:
    async with running_cluster(tmp_path, "--lease-ttl", "2s") as cluster:
        leader = await cluster.leader()
        assert (await register(leader, 1)).lease_ttl_nanos == 2 * 10**9
        await register(leader, 2)
        await renewed_by_somebody(cluster.supernodes)
        await leader.end(signal.SIGKILL)
        survivors = cluster.others(leader)
        ended = asyncio.ensure_future(host_gone(survivors[0], 2))
        async for _ in attempts():
            await renewed_by_somebody(survivors)
            if ended.done():
                break
        found = await called(survivors[1].stub.ResolveHost(pb.ResolveHostRequest(name="host-1")), survivors[1])
        assert found.host.alive
        await host_gone(survivors[0], 1)


async def renewed_by_somebody(supernodes: list[Supernode]) -> None:
    async for _ in attempts():
        for one in supernodes:
            if await renew(one, 1):
                return


async def host_gone(supernode: Supernode, number: int) -> None:
    async for _ in attempts():
        listed = await called(supernode.stub.ListHosts(pb.ListHostsRequest(), timeout=10), supernode)
        if number.to_bytes(16, "big") not in {host.host_id for host in listed.hosts}:
            return


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (("--members", "s1=localhost:1,s1=localhost:2", "--id", "s1"), "names an id twice"),
        (("--members", "s1=localhost:1,s2=localhost:1", "--id", "s1"), "names an address twice"),
        (("--members", "s1=localhost:1,s2=localhost:2"), "--id is ''"),
        (("--members", "s1"), "ID=HOST:PORT"),
        (
            ("--members", "s1=localhost:1", "--id", "s1", "--listen", "localhost:0"),
            "name the port that the list has",
        ),
        (("--lease-ttl", "1ms"), "--lease-ttl: '1ms' cannot be used; allowed: 1 s to"),
        (("--listen", "0.0.0.0:0"), "--allow-insecure-anywhere"),
        (("--members", ",".join(f"s{n}=localhost:{n}" for n in range(1, 11)), "--id", "s1"), "9 at most"),
    ],
)
def test_a_supernode_with_bad_settings_prints_one_line_and_exits_with_2(
    argv: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_runtime.main.set_up_logging", lambda level, form: None)
    assert main(argv) == 2
    error_output = capsys.readouterr().err
    assert message in error_output
    assert error_output.count("\n") == 1


def test_a_data_folder_of_another_member_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def found() -> None:
        cluster = Cluster(tmp_path)
        await cluster.supernodes[0].start()
        await cluster.supernodes[0].end(signal.SIGTERM)
        await cluster.close()

    asyncio.run(found())
    monkeypatch.setattr("stampede_rt_runtime.main.set_up_logging", lambda level, form: None)
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert main(("--listen", "localhost:0", "--id", "stranger", "--data-dir", str(tmp_path / "s1"))) == 1
    error_output = capsys.readouterr().err
    assert error_output.startswith("stampede supernode: ")
    assert error_output.count("\n") == 1


def test_the_supernode_program_refuses_client_verbs_and_names_the_client_program(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["status"]) == 2
    expected = "stampede supernode: this program has no verb 'status'; the client has it: stampede supernode status\n"
    assert capsys.readouterr().err == expected
