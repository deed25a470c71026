"""Measures the round trips to the other supernodes: pings each of them every PERIOD_SECONDS."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

import grpc

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import directory_service_pb2, directory_service_pb2_grpc
from stampede_rt.values.peering import ClockOffset
from stampede_rt_supernode.replication.interface import Member, ReplicatedLog

logger = logging.getLogger(__name__)

PERIOD_SECONDS = 2.0
# How long a member may take to answer a probe.
PROBE_SECONDS = 1.0


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """The result of the last probe of a member. `healthy`: the member has answered that it can serve.

    `round_trip_nanos` is None if the member did not answer. `clock`: how far this supernode's clock is ahead of the
    member's.
    """

    healthy: bool
    round_trip_nanos: int | None
    clock: ClockOffset | None = None


class Probe:
    """Probes every member except this supernode, over one connection for each.

    `explain` may give a better reason than gRPC for a failed connection to a member.
    """

    def __init__(
        self,
        log: ReplicatedLog,
        dial: Callable[[str], grpc.aio.Channel],
        *,
        explain: Callable[[str], Awaitable[StampedeError | None]] | None = None,
    ) -> None:
        self._log = log
        self._explain = explain
        self._logged: dict[str, str] = {}  # address -> the last logged reason why the member refuses this supernode
        self._dial = dial
        self._channels: dict[str, grpc.aio.Channel] = {}
        self._findings: dict[str, ProbeResult] = {}

    def finding(self, member_id: str) -> ProbeResult | None:
        """The result of the last probe of a member; None before the first probe."""
        return self._findings.get(member_id)

    def serves(self, member_id: str) -> bool:
        """Whether another member answered the last probe, and can serve."""
        found = self._findings.get(member_id)
        return found is not None and found.healthy

    def clocks(self) -> dict[str, ClockOffset]:
        """How far this supernode's clock is ahead of each member's clock, as of the last probe that the member
        answered.
        """
        return {name: found.clock for name, found in self._findings.items() if found.clock is not None}

    async def run(self) -> None:
        """Probe until cancelled, then close the connections."""
        try:
            while True:
                await self.round()
                await asyncio.sleep(PERIOD_SECONDS)
        finally:
            await self._close_channels(list(self._channels))

    async def round(self) -> None:
        """Probe each other member once."""
        status = self._log.status()
        others = [member for member in status.members if member.member_id != status.self_id]
        await self._close_channels([one for one in self._channels if one not in {m.address for m in others}])
        findings = await asyncio.gather(*(self._ask(member) for member in others))
        self._findings = {member.member_id: found for member, found in zip(others, findings, strict=True)}

    async def _ask(self, member: Member) -> ProbeResult:
        channel = self._channels.get(member.address)
        if channel is None:
            channel = self._channels[member.address] = self._dial(member.address)
        stub = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        began, sent_unix_nano = time.monotonic_ns(), time.time_ns()
        try:
            pong = await stub.Ping(directory_service_pb2.DirectoryServicePingRequest(), timeout=PROBE_SECONDS)
        except grpc.aio.AioRpcError:  # for some reason this supernode cannot reach the member
            await self._log_refused_certificates(member)
            return ProbeResult(False, None)
        self._logged.pop(member.address, None)
        took = time.monotonic_ns() - began
        clock = ClockOffset.measured(
            sent_unix_nano=sent_unix_nano,
            took_nanos=took,
            told_unix_nano=pong.time_unix_nano,
            supernode=member.member_id,
        )
        return ProbeResult(pong.ready, took, clock)

    async def _log_refused_certificates(self, member: Member) -> None:
        """Log once that certificates are the reason why the member does not answer, if they are the reason."""
        refusal = await self._explain(member.address) if self._explain else None
        if refusal is not None and self._logged.get(member.address) != refusal.message:
            self._logged[member.address] = refusal.message
            logger.warning(
                "no certificates in common with member %s: %s",
                member.member_id,
                refusal.message,
                extra={"event": "member_certificate_refused"},
            )

    async def _close_channels(self, addresses: Sequence[str]) -> None:
        for address in addresses:
            await self._channels.pop(address).close()
