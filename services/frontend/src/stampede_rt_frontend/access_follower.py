"""Keeps this front-end's copy of the access state (such as token keys and revoked serials) equal to the directory's."""

from __future__ import annotations

import logging

import grpc

from stampede_rt.v1 import access_service_pb2, access_service_pb2_grpc
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.messages import state_from
from stampede_rt_runtime.access.state import AccessState

logger = logging.getLogger(__name__)

CALL_SECONDS_MAX = 1.0
_REQUEST = access_service_pb2.GetAccessStateRequest(stale_ok=True)


class AccessFollower:
    """Asks a supernode for the access state when the supernode's answer to a probe names a later version."""

    def __init__(self, control: AccessControl) -> None:
        self._control = control
        self._known: AccessState | None = None

    async def take_version(self, cluster_id: str, version: int, channel: grpc.aio.Channel) -> None:
        """Process the version of the access state in a supernode's answer to a probe.

        If the request for the state fails, the next probe asks again.
        """
        if not self._is_newer(cluster_id, version):
            return
        state = AccessState(cluster_id=cluster_id)
        if version:
            try:
                stub = access_service_pb2_grpc.AccessServiceStub(channel)
                state = state_from(await stub.GetAccessState(_REQUEST, timeout=CALL_SECONDS_MAX))
            except grpc.aio.AioRpcError as error:
                logger.info(
                    "a supernode did not send the access state",
                    extra={"event": "access_rules_unavailable", "why": error.details()},
                )
                return
        if self._is_newer(state.cluster_id, state.version):  # another supernode may have sent a later state meanwhile
            self._known = state
            self._control.set_state(state)

    def _is_newer(self, cluster_id: str, version: int) -> bool:
        known = self._known
        return known is None or known.cluster_id != cluster_id or version > known.version
