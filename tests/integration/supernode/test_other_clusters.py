"""Hosts of one cluster with supernodes of another one, and founders with different lists."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from stampede_rt.cluster.cluster_ids import cluster_metadata
from stampede_rt.errors import Unavailable, WrongCluster
from stampede_rt.v1 import directory_service_pb2 as pb
from tests.support.supernode.commands import cluster_id, command, prepared
from tests.support.supernode.processes import (
    Supernode,
    attempts,
    called,
    free_ports,
    open_channel,
    register,
    resolve,
    running_cluster,
)


async def renewed(one: Supernode, number: int, former: str) -> None:
    """Renew a host's lease. Try again while the supernode begins to lead."""
    request = pb.RenewHostLeaseRequest(host_id=number.to_bytes(16, "big"), boot_incarnation=1)
    metadata = cluster_metadata(former)
    async for _ in attempts():
        try:
            await called(one.stub.RenewHostLease(request, timeout=20, wait_for_ready=True, metadata=metadata), one)
            return
        except WrongCluster:
            raise
        except Unavailable:
            continue


@pytest.mark.parametrize("takes_over", [False, True])
async def test_a_restored_cluster_accepts_hosts_of_the_former_cluster_only_on_request(
    tmp_path: Path, takes_over: bool
) -> None:
    ports, backup = free_ports(2), tmp_path / "backup"
    former = await prepared("init", "a", ports[0], tmp_path)
    former._arguments += ["--lease-ttl", "60s"]  # no lease ends here, however slow the machine is
    running = [former]
    try:
        await former.start()
        await register(former, 1)
        await open_channel(former, "cam/kept")
        former_id = await cluster_id(former)
        code, printed = await command("snapshot", "--member", former.address, "--out", str(backup))
        assert code == 0, printed
        words = ["--restore", str(backup), *(["--take-over"] if takes_over else [])]
        restored = await prepared("init", "r", ports[1], tmp_path, *words)
        running.append(restored)
        await restored.start()
        await resolve(restored, "cam/kept")
        if takes_over:
            await renewed(restored, 1, former_id)
            await register(restored, 1, cluster_id=former_id)
            await restored.end(signal.SIGTERM)
            await restored.start()
            await renewed(restored, 1, former_id)
            return
        for refused in (renewed(restored, 1, former_id), register(restored, 1, cluster_id=former_id)):
            with pytest.raises(WrongCluster, match="cluster may still serve; if that cluster is permanently lost"):
                await refused
        own = await cluster_id(restored)
        assert own != former_id
        await register(restored, 2, cluster_id=own)
        # The host's lease may have ended while the other cluster started. The host's registration is still accepted.
        await register(former, 1, cluster_id=former_id)
    finally:
        for one in running:
            await one.close()


async def test_founders_with_different_lists_create_no_cluster_and_report_the_difference(tmp_path: Path) -> None:
    ports = free_ports(5)
    listed = [f"s{number}=127.0.0.1:{port}" for number, port in enumerate(ports, start=1)]

    def founder(number: int, members: list[str]) -> list[str]:
        name, address = f"s{number}", f"127.0.0.1:{ports[number - 1]}"
        data_dir = str(tmp_path / name)
        return ["--listen", address, "--id", name, "--members", ",".join(members), "--data-dir", data_dir]

    alone = Supernode("s1", f"127.0.0.1:{ports[0]}", founder(1, listed[:3]))
    try:
        await alone.start()
        code, printed = await command(*founder(3, listed))
        assert (code, "start each of them with the same --members" in printed) == (1, True), printed
    finally:
        await alone.close()


async def test_the_members_of_a_listed_cluster_may_be_given_another_list_after_it_is_founded(tmp_path: Path) -> None:
    async with running_cluster(tmp_path) as cluster:
        leader = await cluster.leader()
        await register(leader, 1)
        one, _ = cluster.others(leader)
        await one.end(signal.SIGTERM)
        place = one._arguments.index("--members") + 1
        one._arguments[place] = ",".join(reversed(one._arguments[place].split(","))) + ",s9=127.0.0.1:1"
        await one.start()
        await register(one, 2)  # needs the log; on a slow machine the former host may have lost its lease
