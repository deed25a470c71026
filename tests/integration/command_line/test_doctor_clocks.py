"""`stampede doctor` with services whose clocks and versions the test sets. Real services share this machine's clock."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import pytest

from stampede_rt.cli.main import main as stampede
from stampede_rt.errors import NotLeader
from stampede_rt.status import abort
from stampede_rt.v1 import (
    directory_pb2,
    directory_service_pb2_grpc,
    frontend_service_pb2_grpc,
    gatekeeper_service_pb2_grpc,
    peer_pb2,
    peer_service_pb2_grpc,
)
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.version import VERSION
from stampede_rt_runtime.server import serving

# ruff: noqa: N802  # methods have the names of the RPCs

HOUR_NANOS = 3600 * 10**9


class WholeClusterServer(
    frontend_service_pb2_grpc.FrontendServiceServicer,
    directory_service_pb2_grpc.DirectoryServiceServicer,
    gatekeeper_service_pb2_grpc.GatekeeperServiceServicer,
    peer_service_pb2_grpc.PeerServiceServicer,
):
    """One server that is the front-end, the only supernode and the only host."""

    address = ""
    host_ahead_nanos = 0
    all_ahead_nanos = 0
    host_version = VERSION
    peers: tuple[peer_pb2.PeerRecord, ...] = ()
    leads = True

    def _now(self) -> int:
        return time.time_ns() + self.all_ahead_nanos

    async def Bind(self, request: Any, context: Any) -> frontend_pb.BindResponse:
        return frontend_pb.BindResponse(
            supernodes=self._members(), protocol_version=1, version=VERSION, time_unix_nano=self._now()
        )

    async def ListSupernodes(self, request: Any, context: Any) -> directory_pb.ListSupernodesResponse:
        return directory_pb.ListSupernodesResponse(supernodes=self._members())

    async def ListHosts(self, request: Any, context: Any) -> directory_pb.ListHostsResponse:
        host = directory_pb2.HostRecord(
            name="h1", alive=True, gatekeepers=[directory_pb2.Endpoint(target=self.address)]
        )
        return directory_pb.ListHostsResponse(hosts=[host])

    async def ListPeers(self, request: peer_pb.ListPeersRequest, context: Any) -> peer_pb.ListPeersResponse:
        """A peer on each page."""
        if request.with_clocks and not self.leads:
            await abort(context, NotLeader("this one follows"))
        place = int(request.page_token or 0)
        more = "" if place + 1 >= len(self.peers) else str(place + 1)
        page = peer_pb.ListPeersResponse(peers=self.peers[place : place + 1], next_page_token=more)
        if not request.with_clocks:
            for peer in page.peers:
                peer.ClearField("clock")
        return page

    def _members(self) -> list[directory_pb2.SupernodeRecord]:
        place = directory_pb2.Endpoint(target=self.address)
        return [directory_pb2.SupernodeRecord(supernode_id="s1", endpoint=place)]

    async def Ping(self, request: Any, context: Any) -> Any:
        """Answer a ping of the supernode or of the host. The type of the request says which of them the caller asks."""
        if isinstance(request, gatekeeper_pb.GatekeeperServicePingRequest):
            ahead = self._now() + self.host_ahead_nanos
            return gatekeeper_pb.GatekeeperServicePingResponse(
                time_unix_nano=ahead, lease_held=True, version=self.host_version
            )
        return directory_pb.DirectoryServicePingResponse(
            supernode_id="s1", ready=True, time_unix_nano=self._now(), version=VERSION
        )


@asynccontextmanager
async def running(everything: WholeClusterServer) -> AsyncIterator[None]:
    def register(server: grpc.aio.Server) -> None:
        frontend_service_pb2_grpc.add_FrontendServiceServicer_to_server(everything, server)
        directory_service_pb2_grpc.add_DirectoryServiceServicer_to_server(everything, server)
        gatekeeper_service_pb2_grpc.add_GatekeeperServiceServicer_to_server(everything, server)
        peer_service_pb2_grpc.add_PeerServiceServicer_to_server(everything, server)

    async with serving(register) as server:
        everything.address = server.address
        yield


async def doctor_report(everything: WholeClusterServer, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    async with running(everything):
        code = await asyncio.to_thread(stampede, ["doctor", "--url", everything.address])
    return code, capsys.readouterr().out


async def test_doctor_has_no_finding_if_all_clocks_agree(capsys: pytest.CaptureFixture[str]) -> None:
    code, report = await doctor_report(WholeClusterServer(), capsys)
    assert (code, "Everything is well." in report) == (0, True), report


async def test_a_host_whose_clock_is_ahead_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    everything = WholeClusterServer()
    everything.host_ahead_nanos = HOUR_NANOS
    code, report = await doctor_report(everything, capsys)
    assert code == 1, report
    assert re.search(r"clocks: the clock of host h1 is \S+ [mh] ahead of the others'; synchronise it", report), report
    assert "50 ms are allowed" in report


async def test_doctor_names_this_machine_if_all_clocks_disagree_with_it(capsys: pytest.CaptureFixture[str]) -> None:
    everything = WholeClusterServer()
    everything.all_ahead_nanos = HOUR_NANOS
    code, report = await doctor_report(everything, capsys)
    assert code == 1, report
    assert re.search(
        r"clocks: this machine's clock is \S+ [mh] behind the cluster's; synchronise this machine's", report
    ), report


async def test_a_host_of_another_version_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    everything = WholeClusterServer()
    everything.host_version = "9.9.9"
    code, report = await doctor_report(everything, capsys)
    assert code == 1, report
    assert "9.9.9: host h1" in report
    assert f"{VERSION}: this caller, front-end and supernode s1" in report


def peer(name: str, *, ahead_nanos: int | None = None, supernode: str = "s1") -> peer_pb2.PeerRecord:
    clock = peer_pb2.ClockOffset(offset_nanos=ahead_nanos or 0, uncertainty_nanos=10**6, supernode_id=supernode)
    return peer_pb2.PeerRecord(name=name, alive=True, version="3.1", clock=None if ahead_nanos is None else clock)


def row(report: str, part: str) -> str:
    [found] = [line for line in report.splitlines() if line.startswith(f"{part} ")]
    return found


async def test_every_peer_is_shown_with_its_clock_and_one_that_is_off_is_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    everything = WholeClusterServer()
    everything.peers = (
        peer("robot/good", ahead_nanos=0),
        peer("robot/late", ahead_nanos=-2 * HOUR_NANOS),
        peer("robot/new"),
        peer("robot/stray", ahead_nanos=5 * HOUR_NANOS, supernode="s9"),  # no supernode has pinged s9
    )
    code, report = await doctor_report(everything, capsys)
    assert code == 1, report
    assert re.search(
        r"^clocks: the clock of peer robot/late is (2|1.9\d+|2.0\d+) h behind the others'; sync", report, re.M
    ), report
    assert re.search(r"^peer robot/late +- +ok .* -(2|1.9\d+|2.0\d+) h +- +3\.1$", report, re.M), report
    assert re.search(r" (ns|us|ms) +- +3\.1$", row(report, "peer robot/good")), report
    for unknown in ("robot/new", "robot/stray"):
        assert re.search(r"ok +- +unknown +- +3\.1$", row(report, f"peer {unknown}")), report


async def test_doctor_names_this_machine_if_all_clocks_also_of_peers_disagree_with_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    everything = WholeClusterServer()
    everything.all_ahead_nanos = HOUR_NANOS
    everything.peers = (peer("robot/good", ahead_nanos=0),)
    code, report = await doctor_report(everything, capsys)
    assert (code, report.count("synchronise")) == (1, 1), report
    assert re.search(r" (1|1.0\d+|0.9\d+|59.\d+) [hm] +- +3\.1$", row(report, "peer robot/good")), report


async def test_without_a_leader_peers_are_shown_without_their_clocks(capsys: pytest.CaptureFixture[str]) -> None:
    everything = WholeClusterServer()
    everything.leads = False
    everything.peers = (peer("robot/good", ahead_nanos=0), peer("robot/late", ahead_nanos=-2 * HOUR_NANOS))
    code, report = await doctor_report(everything, capsys)
    assert (code, report.count("unknown")) == (0, 2), report
