"""Keeps this host's copy of the access state (such as rules and quotas) equal to the directory's."""

from __future__ import annotations

import asyncio
import logging
from typing import NoReturn

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import access_service_pb2, access_service_pb2_grpc
from stampede_rt_channel_host.cluster.supernodes import Supernodes, is_unknown_call
from stampede_rt_channel_host.core.records import RecordedChange
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.messages import state_from
from stampede_rt_runtime.access.state import AccessState

logger = logging.getLogger(__name__)

CALL_SECONDS_MAX = 4.0
PAUSE_SECONDS = 0.5


class AccessWatch:
    """Notes the changes that the watch reports (`ChangeFollower`). Then `keep` asks for the access state."""

    def __init__(self, supernodes: Supernodes, control: AccessControl) -> None:
        self._supernodes = supernodes
        self._control = control
        self._due = asyncio.Event()
        self.in_use = asyncio.Event()
        self.in_use.set()  # the watch is needed from the start: the rules apply to every call

    async def missed(self) -> None:
        """Ask for the access state now, because the watch may have missed changes.

        Raises the error with which the directory refuses, or Unavailable.
        """
        self._control.set_state(await self._ask())

    def changed_in_directory(self, change: RecordedChange) -> None:
        """If the change concerns access, have `keep` ask for the access state."""
        if change.is_of_access:
            self._due.set()

    async def keep(self) -> NoReturn:
        """After each change, ask for the access state until an answer comes.

        One request serves all changes that came before it.
        """
        while True:  # paced by the changes
            await self._due.wait()
            self._due.clear()
            try:
                await self.missed()
            except StampedeError as error:
                logger.info(
                    "the rules of access are not available yet",
                    extra={"event": "access_rules_unavailable", "why": str(error)},
                )
                self._due.set()
                await asyncio.sleep(PAUSE_SECONDS)

    async def _ask(self) -> AccessState:
        request = access_service_pb2.GetAccessStateRequest()
        try:
            response: access_service_pb2.GetAccessStateResponse = await self._supernodes.call(
                "GetAccessState", request, CALL_SECONDS_MAX, service=access_service_pb2_grpc.AccessServiceStub
            )
        except StampedeError as error:
            if not is_unknown_call(error):
                raise
            # The supernode does not know the call. While the cluster has such a supernode, its feature level allows no
            # rules. So an empty state is right.
            return AccessState()
        return state_from(response)
