"""Keeps what this host knows of rules and keys of access as the directory has it."""

from __future__ import annotations

import asyncio
import logging
from typing import NoReturn

import grpc

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import access_service_pb2, access_service_pb2_grpc
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_channel_host.core.records import RecordedChange
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.messages import rule_from
from stampede_rt_runtime.access.rules import AccessRules
from stampede_rt_runtime.access.state import AccessState

logger = logging.getLogger(__name__)

CALL_SECONDS_MAX = 4.0
PAUSE_SECONDS = 0.5


class AccessWatch:
    """The changes that the directory watch reports, and the task that then asks for the state. See `Watched`."""

    def __init__(self, supernodes: Supernodes, control: AccessControl) -> None:
        self._supernodes = supernodes
        self._control = control
        self._due = asyncio.Event()
        self.in_use = asyncio.Event()
        self.in_use.set()  # every call is judged

    async def missed(self) -> None:
        """Changes may have been missed. Raises what the directory answers."""
        self._control.tell(await self._ask())

    def changed_in_directory(self, change: RecordedChange) -> None:
        """The directory tells of a change."""
        if change.is_of_access:
            self._due.set()

    async def keep(self) -> NoReturn:
        """Ask for the state after each change, until that is answered. Changes meanwhile are asked for together."""
        while True:  # paced by the changes
            await self._due.wait()
            self._due.clear()
            try:
                await self.missed()
            except StampedeError as error:
                logger.info("the rules of access cannot be had yet", extra={"why": str(error)})
                self._due.set()
                await asyncio.sleep(PAUSE_SECONDS)

    async def _ask(self) -> AccessState:
        request = access_service_pb2.GetAccessStateRequest()
        try:
            told: access_service_pb2.GetAccessStateResponse = await self._supernodes.call(
                "GetAccessState", request, CALL_SECONDS_MAX, service=access_service_pb2_grpc.AccessServiceStub
            )
        except StampedeError as error:
            if not _knows_no_rules(error):
                raise
            return AccessState()
        return AccessState(
            version=told.version,
            cluster_id=told.cluster_id,
            rules=AccessRules(map(rule_from, told.rules)),
            token_keys=tuple(told.token_keys),
            revoked_serials=frozenset(told.revoked_serials),
        )


def _knows_no_rules(error: StampedeError) -> bool:
    """Whether a supernode of an earlier release answered. While there is one, the cluster's feature level lets nobody
    make rules."""
    cause = error.__cause__
    return isinstance(cause, grpc.aio.AioRpcError) and cause.code() is grpc.StatusCode.UNIMPLEMENTED
