"""Moves all channels of this host to other hosts: before it stops, or because an operator asks (paper, section 4.1)."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import grpc

from stampede_rt.errors import ChannelNotFound, DeadlineExceeded, Overloaded, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import migration_service_pb2_grpc
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.copies.move_directory import MoveDirectory
from stampede_rt_channel_host.core.placing import OtherHost, spread, together

logger = logging.getLogger(__name__)

MOVES_AT_ONCE = 6  # of the 8 that a host may have under way; the others are for callers
NAMES_LOGGED_MAX = 20
RETRY_SECONDS_MIN, RETRY_SECONDS_MAX = 0.05, 1.0
BEGIN_SECONDS_MAX = 2.0  # a host that has not begun a move by then gets no other channel during the drain


class Drained(NamedTuple):
    """The number of channels that have moved, and the others by name, with the reasons."""

    moved: int
    left: dict[str, str]


class Draining:
    """Moves the channels of one host away. `groups_of` returns the groups of a channel, `dial` opens connections."""

    def __init__(
        self, store: ChannelStore, directory: MoveDirectory, groups_of: Callable[[bytes], Collection[bytes]],
        dial: Callable[[str], grpc.aio.Channel],
    ) -> None:  # fmt: skip
        self._store = store
        self._directory = directory
        self._groups_of = groups_of
        self._dial = dial

    async def run(self, seconds: float) -> Drained:
        """Move all channels away. Ends after `seconds`, with what has moved by then. Raises nothing."""
        own = self._own()
        left = {one.record.name: "the time was over" for one in own.values()}
        if own:
            try:
                async with asyncio.timeout(seconds):
                    await self._move_all(own, left)
            except TimeoutError:
                pass
            except StampedeError as error:
                left = dict.fromkeys(left, str(error))
        drained = Drained(len(own) - len(left), left)
        self._tell(drained)
        return drained

    def _own(self) -> dict[bytes, HostedChannel]:
        """The channels that this host owns, by id."""
        own = (one for one in self._store.all() if one.copy is None and not one.is_heir and one.epoch)
        return {one.record.channel_id: one for one in own}

    def _tell(self, drained: Drained) -> None:
        if drained.left:
            names = ", ".join([*drained.left][:NAMES_LOGGED_MAX])
            extra = {"event": "channels_not_moved", "channels": names, "count": len(drained.left)}
            logger.warning("%d channels could not be moved to other hosts", len(drained.left), extra=extra)
        elif drained.moved:
            extra = {"event": "host_drained", "channels": drained.moved}
            logger.info("all channels have moved to other hosts", extra=extra)

    async def _move_all(self, own: dict[bytes, HostedChannel], left: dict[str, str]) -> None:
        """Move the channels. Takes each that has moved out of `left`, and notes the reason for each that has not."""
        hosts = await self._directory.other_hosts()
        if not hosts:
            left.update(dict.fromkeys(left, "there is no other live host"))
            return
        places = spread(together({one: self._groups_of(one) for one in own}), hosts)
        others = _Others(hosts, self._dial)
        limit = asyncio.Semaphore(MOVES_AT_ONCE)
        try:
            async with asyncio.TaskGroup() as moves:
                for channel_id, hosted in own.items():
                    moves.create_task(self._move(hosted, places[channel_id], others, limit, left))
        finally:
            await others.aclose()

    async def _move(
        self, hosted: HostedChannel, host: OtherHost | None, others: _Others, limit: asyncio.Semaphore,
        left: dict[str, str],
    ) -> None:  # fmt: skip
        """Move one channel.

        Tries one host after the other for as long as they have no room, have too many moves, or do not answer.
        """
        name, delay_s = hosted.record.name, RETRY_SECONDS_MIN
        while host is not None and self._is_here(hosted):  # paced by the sleep; `Draining.run` ends it
            try:
                async with limit:
                    await others.move(hosted, host)
                    break
            except ChannelNotFound:  # deleted meanwhile
                break
            except StampedeError as error:
                left[name] = str(error)
                if error.reason == "SHUTTING_DOWN" or isinstance(error, DeadlineExceeded):
                    others.leave_out(host)
                elif not isinstance(error, Overloaded | Unavailable) and error.reason != "MOVE_CONFLICT":
                    return
            host = others.after(host)
            await asyncio.sleep(delay_s)
            delay_s = min(2 * delay_s, RETRY_SECONDS_MAX)
        if host is not None or not self._is_here(hosted):
            left.pop(name)

    def _is_here(self, hosted: HostedChannel) -> bool:
        """Whether this host still owns the channel. A move may come to its end although its caller got no answer."""
        return self._store.serves(hosted) and not hosted.is_heir


class _Others:
    """The other hosts during one drain, and the connections to them."""

    def __init__(self, hosts: Sequence[OtherHost], dial: Callable[[str], grpc.aio.Channel]) -> None:
        self._hosts = [*hosts]
        self._dial = dial
        self._connections: dict[str, grpc.aio.Channel] = {}

    async def move(self, hosted: HostedChannel, host: OtherHost) -> None:
        """Have a host take the channel over.

        Raises the errors of MigrationService.MoveHere, Unavailable, and DeadlineExceeded if the host has not begun the
        move after BEGIN_SECONDS_MAX.
        """
        if host.target not in self._connections:
            self._connections[host.target] = self._dial(host.target)
        stub = migration_service_pb2_grpc.MigrationServiceStub(self._connections[host.target])
        request = pb.MoveHereRequest(channel_id=hosted.record.channel_id)
        while True:  # the source ends a move whose destination is silent; each call joins the move
            try:
                await stub.MoveHere(request, timeout=BEGIN_SECONDS_MAX)
                return
            except grpc.RpcError as error:
                plain = from_rpc_error(error, host.target)
                if not isinstance(plain, DeadlineExceeded) or hosted.moving is None:
                    raise plain from error

    def leave_out(self, host: OtherHost) -> None:
        """Choose this host no more, because it stops. Idempotent."""
        self._hosts = [one for one in self._hosts if one is not host]

    def after(self, host: OtherHost) -> OtherHost | None:
        """The host to try after `host`: each in turn. None: there is none."""
        later = [one for one in self._hosts if one.host_id > host.host_id]
        return min(later or self._hosts, key=lambda one: one.host_id, default=None)

    async def aclose(self) -> None:
        """Close the connections."""
        for connection in self._connections.values():
            await connection.close(None)
