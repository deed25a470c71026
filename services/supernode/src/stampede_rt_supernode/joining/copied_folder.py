"""Finds out whether this process runs from a copy of a supernode's data folder.

Two processes with copies of one folder would both vote and acknowledge as one member. The process at the supernode's
address counts as the supernode. The other process ends.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import grpc

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import directory_service_pb2_grpc

LOOK_SECONDS = 2.0  # the pause between two looks at the address
ASK_SECONDS = 1.0  # the time that one look waits for an answer
# How many looks in a row must find another process. A former process of this supernode may take a moment to end.
FINDINGS_NEEDED = 3


class OwnAddress:
    """The address at which the others call this supernode, and the process that answers there.

    `boot`: the boot incarnation of this process.
    """

    def __init__(self, supernode_id: str, address: str, boot: int, dial: Callable[[str], grpc.aio.Channel]) -> None:
        self._supernode_id, self._address, self._boot = supernode_id, address, boot
        self._dial = dial

    async def check(self) -> None:
        """Raises StampedeError if another process at the address answers as this supernode. Waits up to ASK_SECONDS."""
        async with self._dial(self._address) as channel:
            if await self._boot_of_answer(channel) not in (None, self._boot):
                raise self._is_copy()

    async def watch(
        self, cluster_id: Callable[[], str], *, sleep: Callable[[float], Awaitable[None]] = asyncio.sleep
    ) -> None:
        """Call the address every LOOK_SECONDS, until this process itself answers there.

        `cluster_id`: the id of this supernode's cluster. A supernode of another cluster is not a copy. Raises
        StampedeError if another process answers FINDINGS_NEEDED times in a row.
        """
        findings = 0
        async with self._dial(self._address) as channel:
            while (boot := await self._boot_of_answer(channel, cluster_id())) != self._boot:
                findings = 0 if boot is None else findings + 1
                if findings >= FINDINGS_NEEDED:
                    raise self._is_copy()
                await sleep(LOOK_SECONDS)

    async def _boot_of_answer(self, channel: grpc.aio.Channel, cluster_id: str = "") -> int | None:
        """The boot incarnation of the process that answers as this supernode; None if no such process answers."""
        stub = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        try:
            pong = await stub.Ping(pb.DirectoryServicePingRequest(), timeout=ASK_SECONDS)
        except grpc.aio.AioRpcError:
            return None
        is_own = pong.supernode_id == self._supernode_id and cluster_id in ("", pong.cluster_id)
        return int(pong.boot_incarnation) if is_own else None

    def _is_copy(self) -> StampedeError:
        return StampedeError(
            f"supernode {self._supernode_id} runs at {self._address} already, and this is another process with a copy "
            "of its folder; delete this copy. To move a supernode, replace it (stampede supernode remove, then join "
            "under a new id)"
        )
