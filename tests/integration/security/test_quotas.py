"""Quotas of callers in a running cluster, as an operator sets them and clients meet them."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt._sync import attempts, directory_client, reads
from stampede_rt.cli.commands import run
from stampede_rt.errors import Overloaded
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from stampede_rt.v1.peer_service_pb2_grpc import PeerServiceStub
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture

pytestmark = pytest.mark.without_rules("it acts as an operator")
cluster = cluster_fixture()
CLIENT = "team/cam-1"


class Operator:
    """Gives out tokens and sets quotas by the command line, and takes its settings back."""

    def __init__(self, cluster: LocalCluster, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.address, self._folder, self.capsys = cluster.address, folder, capsys
        self._set: set[str] = set()

    def output_of(self, *words: str, status: int = 0, out: bool | None = None) -> str:
        self.capsys.readouterr()
        assert run([*words, "--url", self.address]) == status
        captured = self.capsys.readouterr()
        return captured.out if out or status == 0 else captured.err

    def set(self, who: str, *limits: str) -> str:
        self._set.add(who)
        return self.output_of("quota", "set", who, *limits)

    def rows(self, *words: str) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = json.loads(self.output_of("quota", *words, "-o", "json"))
        return rows

    def token(self, name: str) -> str:
        file = self._folder / "token"
        self.output_of("token", "issue", name, "--out", str(file))
        return file.read_text().strip()

    def take_back(self) -> None:
        for who in self._set:
            self.output_of("quota", "rm", who)


@pytest.fixture
def operator(cluster: LocalCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Iterator[Operator]:
    one = Operator(cluster, tmp_path, capsys)
    yield one
    one.take_back()


@pytest.fixture
def client(cluster: LocalCluster, operator: Operator, monkeypatch: pytest.MonkeyPatch) -> Iterator[st.Connection]:
    monkeypatch.setattr(reads, "CALL_TIMEOUT_S", 0.1)  # the client repeats a refused get for this time
    with st.connect(cluster.address, secret=operator.token(CLIENT)) as rt:
        yield rt


def test_a_client_above_its_quota_gets_an_error_with_advice_and_keeps_its_streams(
    operator: Operator, client: st.Connection
) -> None:
    channel = client.channel("quotas/video")
    channel.put(b"frame")
    with channel.subscribe(start=st.OLDEST) as subscription:
        assert next(subscription).payload == b"frame"
        operator.set("team/*", "bytes-in-flight=0")
        with pytest.raises(Overloaded) as caught:
            channel.newest()
        assert caught.value.message.startswith(
            f"channel 'quotas/video': {CLIENT} has 0 bytes in flight at this port and wants "
        )
        assert caught.value.message.endswith(
            "its quota bytes-in-flight is 0; put and read less at a time, or have an operator raise the quota "
            f"(stampede quota set {CLIENT} bytes-in-flight=LIMIT)"
        )
        channel.put(b"next")
        assert next(subscription).payload == b"next"
        operator.set(CLIENT, "bytes-in-flight=1MiB")
        assert channel.newest().payload == b"next"


def test_the_use_and_the_refusals_of_each_caller_are_shown_for_each_part(
    operator: Operator, client: st.Connection
) -> None:
    channel = client.channel("quotas/refused")
    channel.put(b"x")
    operator.set(CLIENT, "bytes-in-flight=0")
    with channel.subscribe(), pytest.raises(Overloaded):
        channel.newest()
    host = {row["quota"]: row for row in operator.rows("use", "team/*") if row["at"].startswith("host ")}
    assert host["bytes-in-flight"]["refused"] >= 1
    assert host["bytes-in-flight"]["limit"] == 0
    assert host["streams"]["who"] == CLIENT
    assert operator.rows("use", "team/unheard-of") == []
    assert "calls refused, the last one" in operator.output_of("doctor", status=1, out=True)


def test_a_quota_of_some_callers_does_not_limit_a_caller_with_the_secret_of_the_cluster(
    cluster: LocalCluster, operator: Operator, client: st.Connection
) -> None:
    operator.set("team/*", "streams=0", "waiting-calls=0")
    with st.connect(cluster.address, secret=cluster.secret.text) as rt:
        rt.channel("quotas/of-others").put(b"x")


def test_a_client_makes_no_more_channels_and_no_faster_than_its_quotas_allow(
    cluster: LocalCluster, operator: Operator
) -> None:
    metadata = (("authorization", f"Bearer {operator.token('maker')}"),)

    def make(name: str) -> str:
        """Make a thing. Returns the quota that refused it; empty if it was made."""
        request = directory_pb.OpenChannelRequest(request_id=secrets.token_bytes(16), name=name, create=True)
        try:
            open_channel(request, metadata=metadata, timeout=10)
        except grpc.RpcError as error:
            refused = from_rpc_error(error, "")
            assert isinstance(refused, Overloaded)
            return refused.metadata["quota"]
        return ""

    with grpc.insecure_channel(cluster.supernodes[0].address) as connection:
        open_channel: Any = DirectoryServiceStub(connection).OpenChannel
        operator.set("maker", "channels=2")
        assert [make(f"quotas/made/{number}") for number in range(3)] == ["", "", "channels"]
        rows = [row for row in operator.rows("use", "maker") if row["quota"] == "channels"]
        assert len(rows) == len(cluster.supernodes)
        assert {(row["used"], row["limit"]) for row in rows} == {(2, 2)}
        assert sum(row["refused"] for row in rows) == 1
        assert make("quotas/made/1") == ""  # this channel exists already
        operator.set("maker", "channels=unlimited", "changes-per-second=1")
        refusals = [make(f"quotas/faster/{number}") for number in range(40)]
    assert refusals[0] == ""
    assert "changes-per-second" in refusals
    refused = {row["quota"]: row["refused"] for row in operator.rows("use", "maker")}
    assert refused["changes-per-second"] == refusals.count("changes-per-second")
    assert "calls refused, the last one" in operator.output_of("doctor", status=1, out=True)


def test_a_client_at_its_quota_of_channels_or_queues_does_not_try_again(
    cluster: LocalCluster, operator: Operator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sleep(delay_s: float) -> None:
        raise AssertionError("the client waits for another try")

    operator.set("keeper", "channels=1", "queues=1")
    with st.connect(cluster.address, secret=operator.token("keeper")) as rt:
        for kind, make in (("channels", rt.channel), ("queues", rt.queue)):
            make(f"quotas/kept/{kind}")
            for module in (attempts, directory_client):
                monkeypatch.setattr(module, "sleep", sleep)
            with pytest.raises(Overloaded) as caught:
                make(f"quotas/too-many/{kind}")
            assert (caught.value.metadata["quota"], caught.value.retryable) == (kind, False)
            monkeypatch.undo()


def test_a_client_has_no_more_groups_and_peers_than_its_quotas_allow(cluster: LocalCluster, operator: Operator) -> None:
    operator.set("grouper", "groups=1", "peers=1")
    token = operator.token("grouper")
    with st.connect(cluster.address, secret=token, name="quotas-p1") as rt:
        members = [rt.channel("quotas/grouped")]
        group = rt.group("quotas/g1", members)
        with pytest.raises(Overloaded) as caught:
            rt.group("quotas/g2", members)
        assert caught.value.metadata["quota"] == "groups"
        with grpc.insecure_channel(cluster.supernodes[0].address) as connection:
            register: Any = PeerServiceStub(connection).RegisterPeer
            request = peer_pb.RegisterPeerRequest(
                request_id=secrets.token_bytes(16), peer_id=secrets.token_bytes(16), boot_incarnation=1
            )
            with pytest.raises(grpc.RpcError, match="grouper has registered 1 peers that still exist; its quota"):
                register(request, metadata=(("authorization", f"Bearer {token}"),), timeout=10)
        uses = [row for row in operator.rows("use", "grouper") if row["quota"] in ("groups", "peers")]
        assert {(row["quota"], row["used"], row["limit"]) for row in uses} == {("groups", 1, 1), ("peers", 1, 1)}
        assert {row["quota"] for row in uses if row["refused"]} == {"groups", "peers"}
        group.delete()
        rt.group("quotas/g2", members)


def test_a_quota_above_the_whole_event_loop_is_refused(operator: Operator) -> None:
    error_output = operator.output_of("quota", "set", "cam", "cpu-percent=300", status=2)
    assert "cpu-percent is 300; a service has 100 % of its event loop" in error_output


def test_settings_are_listed_with_the_defaults_and_checked_for_one_caller(operator: Operator) -> None:
    assert operator.set("cam-*", "streams=7", "bytes-in-flight=64MiB") == (
        "streams of cam-* is 7.\nbytes-in-flight of cam-* is 64.0 MiB.\n"
    )
    assert operator.set("cam-*", "streams=7") == "streams of cam-* is 7 already.\n"
    operator.set("cam-1", "streams=unlimited")
    listed = operator.rows("ls")
    assert {"who": "cam-*", "quota": "bytes-in-flight", "limit": 64 * 2**20} in listed
    assert {"who": "(default)", "quota": "streams", "limit": 3072} in listed
    found = {row["quota"]: (row["limit"], row["set_for"]) for row in operator.rows("check", "cam-1")}
    assert found["streams"] == (2**62, "cam-1")
    assert found["bytes-in-flight"] == (64 * 2**20, "cam-*")
    assert found["subscriptions"] == (2048, "(default)")
    assert operator.output_of("quota", "rm", "cam-*", "streams") == "1 limit of cam-* is removed.\n"
    assert operator.output_of("quota", "rm", "cam-9") == "No such limit was set for cam-9.\n"


def test_a_wrong_quota_is_refused_with_advice(operator: Operator) -> None:
    assert "is a pattern; name one caller" in operator.output_of("quota", "check", "cam-*", status=2)
    # In an earlier version, the command took the address for a client's name.
    for arguments in (("set", "10.0.0.3", "streams=3"), ("check", "10.0.0.3")):
        assert "10.0.0.3 is an address; write @10.0.0.3" in operator.output_of("quota", *arguments, status=2)
    assert "no caller that matches 'nobody' uses any quota" in operator.output_of("quota", "use", "nobody")
    for words, complaint in (
        (("cam", "x=3"), "there is no quota 'x'; the quotas are streams, "),
        (("cam", "streams=3MiB"), "write it as streams=100, or streams=unlimited"),
        (("cam", "bytes-in-flight"), "write it as bytes-in-flight=64MiB"),
    ):
        with pytest.raises(SystemExit):
            operator.output_of("quota", "set", *words)
        assert complaint in operator.capsys.readouterr().err


def test_a_client_changes_no_quotas(operator: Operator, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    operator.token("cam")
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(tmp_path / "token"))
    for words in (("set", "cam", "streams=9"), ("ls",), ("use",)):
        assert "client cam may not call" in operator.output_of("quota", *words, status=1)
    monkeypatch.undo()
