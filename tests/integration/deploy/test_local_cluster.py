"""A real cluster of three supernodes, a front-end and two hosts, as other tests use it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import grpc
import pytest

from stampede_rt.v1 import (
    directory_pb2,
    directory_service_pb2,
    directory_service_pb2_grpc,
    frontend_service_pb2,
    frontend_service_pb2_grpc,
)
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceFailed
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.dial import dial
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=2, supernodes=3, scope="module")
WRONG = Secret(text="wrong", path=Path("secret"))


async def bind(cluster: LocalCluster) -> frontend_service_pb2.BindResponse:
    async with dial(cluster.address, secret=cluster.secret) as channel:
        stub = frontend_service_pb2_grpc.FrontendServiceStub(channel)
        return await stub.Bind(frontend_service_pb2.BindRequest(protocol_version=1), timeout=10)


async def host_records(cluster: LocalCluster, supernode: int = 0) -> dict[str, directory_pb2.HostRecord]:
    async with dial(cluster.supernodes[supernode].address, secret=cluster.secret) as channel:
        stub = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        answer = await stub.ListHosts(directory_service_pb2.ListHostsRequest(), timeout=10)
    return {one.name: one for one in answer.hosts}


async def test_every_service_of_a_local_cluster_is_ready(cluster: LocalCluster) -> None:
    answer = await bind(cluster)
    assert {one.supernode_id for one in answer.supernodes} == {"s1", "s2", "s3"}
    assert {one.endpoint.target for one in answer.supernodes} == {one.address for one in cluster.supernodes}
    assert answer.supernodes[0].healthy
    for number in range(3):
        assert list(await host_records(cluster, number)) == ["h1", "h2"]


@pytest.mark.parametrize("secret", [None, WRONG])
async def test_every_port_refuses_callers_without_the_secret(cluster: LocalCluster, secret: Secret | None) -> None:
    """The methods may be of any service: the port checks the secret before it looks up the method."""
    for process in cluster.processes():
        async with dial(process.address, secret=secret) as channel:
            for method in ("/stampede_rt.v1.DirectoryService/Ping", "/stampede_rt.v1.RaftService/Link", "/x/Y"):
                with pytest.raises(grpc.aio.AioRpcError) as caught:
                    await channel.unary_unary(method)(b"", timeout=10)
                assert caught.value.code() is grpc.StatusCode.UNAUTHENTICATED, (process.name, method)


async def until(condition: Callable[[frontend_service_pb2.BindResponse], bool], cluster: LocalCluster) -> None:
    answer = await bind(cluster)
    for _ in range(2000):  # each round is a call, so this waits for the cluster, bounded by the test's own time limit
        if condition(answer):
            return
        answer = await bind(cluster)
    raise AssertionError(f"the condition never came true; the last answer: {answer}")


async def test_a_killed_supernode_is_listed_last_until_it_answers_again(cluster: LocalCluster) -> None:
    victim = cluster.supernodes[0]
    await until(lambda answer: all(one.healthy for one in answer.supernodes), cluster)
    victim.kill()
    await until(lambda answer: [one.healthy for one in answer.supernodes] == [True, True, False], cluster)
    assert (await bind(cluster)).supernodes[-1].supernode_id == "s1"
    victim.restart()
    await until(lambda answer: all(one.healthy for one in answer.supernodes), cluster)


async def test_a_killed_host_returns_with_its_id_and_name(cluster: LocalCluster) -> None:
    victim = cluster.hosts[0]
    before = await host_records(cluster)
    victim.kill()
    victim.restart()
    after = await host_records(cluster)
    assert after["h1"].alive
    assert after["h1"].host_id == before["h1"].host_id
    assert after["h1"].boot_incarnation != before["h1"].boot_incarnation


async def test_a_host_can_be_added(cluster: LocalCluster) -> None:
    added = cluster.add_host()
    assert added.alive
    assert list(await host_records(cluster)) == ["h1", "h2", "h3"]


def test_no_process_or_file_is_left_when_the_cluster_ends() -> None:
    with LocalCluster(hosts=0, supernodes=1) as made:
        folder = made.folder
        assert folder is not None
        assert made.secret_file.stat().st_mode & 0o777 == 0o600
        assert (folder / "s1").is_dir()
    assert not any(one.alive for one in made.processes())
    assert [one.exit_code for one in made.processes()] == [0, 0]
    assert not folder.exists()


def test_a_cluster_that_cannot_start_reports_the_reason_and_leaves_no_process(tmp_path: Path) -> None:
    (tmp_path / "s1").write_text("a file where the supernode wants its folder")
    made = LocalCluster(hosts=1, supernodes=1, folder=tmp_path)
    with pytest.raises(ServiceFailed, match="supernode s1 ended with exit code"):
        made.start(timeout=1000)  # the host would wait for the supernode all this time
    assert not any(one.alive for one in made.processes())


def test_a_cluster_in_memory_with_the_users_secret_writes_no_files(tmp_path: Path) -> None:
    with LocalCluster(hosts=0, supernodes=1, durable=False, secret_file=tmp_path / "secret") as made:
        assert made.folder is None
    assert [one.name for one in tmp_path.iterdir()] == ["secret"]


@pytest.mark.parametrize("settings", [{"supernodes": 0}, {"frontends": 0}, {"hosts": -1}])
def test_a_cluster_needs_a_directory_and_a_front_end(settings: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="at least one supernode and one front-end"):
        LocalCluster(**settings)
