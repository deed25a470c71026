"""FrontendService on the wire: checks requests, asks the roster, encodes responses."""

from __future__ import annotations

from stampede_rt.cluster.addresses import is_loopback
from stampede_rt.errors import Unavailable, VersionMismatch
from stampede_rt.v1 import directory_pb2, frontend_service_pb2, frontend_service_pb2_grpc
from stampede_rt_frontend.probe import Prober
from stampede_rt_frontend.ranking import Supernode, rank
from stampede_rt_frontend.roster import SupernodeRoster
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.messages import status_message
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.routes import is_of_another_machine
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_runtime.version import PROTOCOL_VERSION, software_version

WAIT_SECONDS_MAX = 2.0  # the time that a caller waits until a supernode can serve


class FrontendServicer(frontend_service_pb2_grpc.FrontendServiceServicer):
    """Tells callers the addresses of the supernodes."""

    def __init__(
        self,
        roster: SupernodeRoster,
        prober: Prober,
        clock: HostClock,
        access: AccessControl,
        *,
        default_zone: str = "",
    ) -> None:
        self._roster = roster
        self._prober = prober
        self._access = access
        self._clock = clock
        self._default_zone = default_zone
        self.binds = 0  # the calls of `Bind` so far

    @errors_as_status
    async def Bind(  # noqa: N802 - the name of the RPC
        self, request: frontend_service_pb2.BindRequest, context: Context
    ) -> frontend_service_pb2.BindResponse:
        """The supernodes, best first. If none can serve, waits up to WAIT_SECONDS_MAX until one can.

        Raises VersionMismatch for a caller of another protocol version. Raises Unavailable (NO_QUORUM) if no supernode
        answers, or if the caller cannot call their addresses.
        """
        self.binds += 1
        _check_version(request)
        await self._prober.wait_healthy(WAIT_SECONDS_MAX)
        response = self._respond(request.zone or self._default_zone)
        _check_callable(response, context.peer())
        return response

    def _respond(self, zone: str) -> frontend_service_pb2.BindResponse:
        if not self._roster.any_answered():
            why = "; ".join(self._roster.failures()) or "it has reached none yet"
            raise Unavailable(
                f"no supernode answers this front-end ({why}); start them, or correct the front-end's --supernodes",
                reason="NO_QUORUM",
            )
        return frontend_service_pb2.BindResponse(
            supernodes=[_record(node) for node in rank(self._roster.supernodes(), zone)],
            cluster_id=self._roster.cluster_id,
            former_cluster_ids=self._roster.former_cluster_ids,
            protocol_version=PROTOCOL_VERSION,
            version=software_version(),
            time_unix_nano=self._clock.time_unix_nano(),
            access=status_message(self._access),
        )


def _check_version(request: frontend_service_pb2.BindRequest) -> None:
    if request.protocol_version != PROTOCOL_VERSION:
        raise VersionMismatch(
            f"the caller speaks protocol version {request.protocol_version}, this cluster {PROTOCOL_VERSION} "
            f"(software {software_version()}); install the same release on both sides",
            metadata={"protocol_version": str(PROTOCOL_VERSION), "version": software_version()},
        )


def _check_callable(response: frontend_service_pb2.BindResponse, peer: str) -> None:
    """Raises Unavailable if the caller is on another machine and cannot call the address of any supernode."""
    targets = [record.endpoint.target for record in response.supernodes]
    if targets and all(map(is_loopback, targets)) and is_of_another_machine(peer):
        raise Unavailable(
            f"the supernodes of this cluster are known as {', '.join(targets)}, which only their own machine can call; "
            "create the cluster again, with addresses that other machines can call (--listen or --advertise of the "
            "supernodes)",
            reason="NO_QUORUM",
        )


def _record(node: Supernode) -> directory_pb2.SupernodeRecord:
    return directory_pb2.SupernodeRecord(
        supernode_id=node.supernode_id,
        endpoint=directory_pb2.Endpoint(target=node.target, zone=node.zone),
        is_leader=node.is_leader,
        healthy=node.healthy,
        round_trip_nanos=node.round_trip_nanos,
    )
