"""Moves all channels and queues away from a host that stops, or that an operator drains (paper, section 4.1)."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Collection, Sequence
from typing import NamedTuple

import grpc

from stampede_rt.errors import (
    ChannelNotFound,
    DeadlineExceeded,
    HostNotFound,
    LeaseExpired,
    MoveConflict,
    Overloaded,
    PermissionDenied,
    QueueNotFound,
    StaleBinding,
    StampedeError,
    Unavailable,
)
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import migration_service_pb2_grpc
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.copies.moves.drain_requests import DrainRequests
from stampede_rt_channel_host.copies.moves.drain_room import DrainRoom
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.own_subjects import OwnSubject, owned_by
from stampede_rt_channel_host.core.placing import OtherHost, connected_sets, spread
from stampede_rt_channel_host.queues.queue_store import QueueStore

logger = logging.getLogger(__name__)

Dial = Callable[[str], grpc.aio.Channel]
NAMES_LOGGED_MAX = 20
# After these errors another host, or later the same one, may take the channel. After StaleBinding this host has ended
# the move, and tries again. After HostNotFound and LeaseExpired the other host has lost its lease during the move.
_RETRYABLE = (Overloaded, Unavailable, DeadlineExceeded, MoveConflict, StaleBinding, HostNotFound, LeaseExpired)
RETRY_SECONDS_MIN, RETRY_SECONDS_MAX = 0.05, 1.0
BEGIN_SECONDS_MAX = 2.0  # the drain tries another host if one has not begun a move after this time


class DrainResult(NamedTuple):
    """The number of channels and queues that have moved, and the others by name, with the reasons."""

    moved: int
    unmoved: dict[str, str]


class HostDrain:
    """Moves the channels and queues of one host away.

    `groups_of` returns the groups of a channel, `dial` opens connections, and `dial_streams` opens connections for one
    stream.
    """

    def __init__(
        self, store: ChannelStore, queues: QueueStore, directory: MoveDirectory,
        groups_of: Callable[[bytes], Collection[bytes]], dial: Dial, dial_streams: Dial,
        allow: Callable[[bytes, int, bytes], None],
    ) -> None:  # fmt: skip
        """`allow` notes that another host may ask for a channel or queue, see `AllowedMoves.allow`."""
        self._store = store
        self._queues = queues
        self._directory = directory
        self._groups_of = groups_of
        self._dial, self._dial_streams = dial, dial_streams
        self._allow = allow

    async def run(self, seconds: float, *, arrivals: Sequence[Callable[[], Awaitable[None]]] = ()) -> DrainResult:
        """Move all channels and queues away. Ends after `seconds`, even if some have not moved. Raises nothing.

        The log names the channels and queues that have not moved, also if the caller cancels this call.
        `arrivals`: the host stops after this call, and the items in its memory are lost. Each function waits for the
        end of moves to this host that were under way. The drain then moves these channels and queues, too.
        """
        own: dict[bytes, OwnSubject] = {}
        unmoved: dict[bytes, str] = {}
        self._add_own(own, unmoved)
        try:
            async with asyncio.timeout(seconds):
                if own:
                    await self._move_all(own, unmoved, arrivals)
                else:
                    await _wait_for(arrivals)
                while arrivals and (arrived := self._add_own(own, unmoved)):  # each channel and queue once
                    await self._move_all(arrived, unmoved)
        except TimeoutError:
            pass
        except StampedeError as error:
            unmoved.update(dict.fromkeys(unmoved, str(error)))
        finally:  # also if a second signal cancels the drain
            if arrivals:
                self._add_own(own, unmoved)
            moved = len(own) - len(unmoved)
            _log_outcome(moved, {own[one]: why for one, why in unmoved.items()}, is_last=bool(arrivals))
        return DrainResult(moved, {own[one].name: why for one, why in unmoved.items()})

    def _add_own(self, own: dict[bytes, OwnSubject], unmoved: dict[bytes, str]) -> dict[bytes, OwnSubject]:
        """Add the channels and queues that this host owns to `own` and `unmoved`. Returns the added ones."""
        added = {one: subject for one, subject in owned_by(self._store, self._queues).items() if one not in own}
        own |= added
        unmoved |= dict.fromkeys(added, "the drain ended before the move")
        return added

    async def _move_all(
        self,
        own: dict[bytes, OwnSubject],
        unmoved: dict[bytes, str],
        arrivals: Sequence[Callable[[], Awaitable[None]]] = (),
    ) -> None:
        """Move the channels and queues of `own`, and the ones that are here after `arrivals`.

        Removes each moved one from `unmoved`, and enters there the reason for each other one.
        """
        hosts = await self._directory.other_hosts()
        if not hosts:
            unmoved.update(dict.fromkeys(own, "there is no other live host"))
            return
        others = _OtherHosts(hosts, self._dial, self._dial_streams, self._allow)

        def begin(subjects: dict[bytes, OwnSubject]) -> None:
            places = spread(connected_sets({one: self._groups_of(one) for one in subjects}), hosts)
            for one in subjects.values():
                moves.create_task(_move(one, places[one.id], others, unmoved))

        try:
            async with asyncio.TaskGroup() as moves:
                begin(own)
                if arrivals:
                    await _wait_for(arrivals)
                    begin(self._add_own(own, unmoved))
        finally:
            await others.aclose()


async def _wait_for(arrivals: Sequence[Callable[[], Awaitable[None]]]) -> None:
    for ended in arrivals:
        await ended()


class _OtherHosts:
    """The other hosts during one drain, and the connections to them."""

    def __init__(
        self, hosts: Sequence[OtherHost], dial: Dial, dial_streams: Dial, allow: Callable[[bytes, int, bytes], None]
    ) -> None:
        self._hosts = [*hosts]
        self._allow = allow
        self._dial, self._dial_streams = dial, dial_streams
        self._room = DrainRoom()
        self._silent: set[bytes] = set()  # the hosts that have not begun the latest move
        self._connections: dict[str, grpc.aio.Channel] = {}
        self._requests: dict[str, DrainRequests] = {}

    async def move(self, own: OwnSubject, host: OtherHost) -> OtherHost:
        """Have a host take a channel or queue over, as soon as the limits allow another move.

        Returns `host` after the move. If `host` has become silent meanwhile, returns another host to try. Raises
        the errors of MigrationService.MoveHere, Unavailable, and DeadlineExceeded if the host has not begun the move
        after BEGIN_SECONDS_MAX.
        """
        async with self._room.move_slot(host.host_id, is_queue=own.is_queue):
            other = self.after(own, host) if host.host_id in self._silent else host
            if other is host or other is None or other.host_id in self._silent:
                begun_s = time.monotonic()
                await self._ask(own, host)
                self._room.note_move(host.host_id, time.monotonic() - begun_s)
        return other or host

    async def _ask(self, own: OwnSubject, host: OtherHost) -> None:
        while True:  # the source ends a move whose destination is silent; each request joins the move
            self._allow(own.id, own.epoch, host.host_id)
            try:
                await self._take_over(own, host.target)
                self._silent.discard(host.host_id)
                return
            except DeadlineExceeded:
                if not own.is_moving:
                    self._silent.add(host.host_id)
                    raise

    async def _take_over(self, own: OwnSubject, target: str) -> None:
        """Send one request. All channels share one stream, and each queue has a call of its own.

        At a host of an older release each channel has a call of its own, too.
        """
        if target not in self._requests:
            self._connections[target] = self._dial(target)
            self._requests[target] = DrainRequests(target, self._dial_streams(target))
        if not own.is_queue and await self._requests[target].take(own.id, BEGIN_SECONDS_MAX):
            return
        stub = migration_service_pb2_grpc.MigrationServiceStub(self._connections[target])
        try:
            await stub.MoveHere(own.request, timeout=BEGIN_SECONDS_MAX)
        except grpc.RpcError as error:
            raise from_rpc_error(error, target) from error

    def leave_out(self, host: OtherHost) -> None:
        """Stop choosing this host, because it stops. Idempotent."""
        self._hosts = [one for one in self._hosts if one is not host]

    def first(self, own: OwnSubject, host: OtherHost) -> OtherHost | None:
        """`host`, or another host if this one cannot have the channel. None: no host can have it."""
        return host if host.has_archive or not own.needs_archive else self.after(own, host)

    def after(self, own: OwnSubject, host: OtherHost) -> OtherHost | None:
        """The host to try after `host`. Each host has its turn; silent hosts come last. None: there is no host."""
        fitting = [one for one in self._hosts if one.has_archive or not own.needs_archive]
        hosts = [one for one in fitting if one.host_id not in self._silent] or fitting
        later = [one for one in hosts if one.host_id > host.host_id]
        return min(later or hosts, key=lambda one: one.host_id, default=None)

    async def aclose(self) -> None:
        """Close the connections."""
        for requests in self._requests.values():
            await requests.aclose()
        for connection in self._connections.values():
            await connection.close(None)


async def _move(own: OwnSubject, place: OtherHost, others: _OtherHosts, unmoved: dict[bytes, str]) -> None:
    """Move one channel or queue.

    Tries one host after the other while they have no room, have too many moves, or do not answer.
    """
    delay_s, host = RETRY_SECONDS_MIN, others.first(own, place)
    if host is None:
        unmoved[own.id] = "it is recorded (archive), and no other live host has an archive"
    while host is not None and own.is_here:  # paced by the sleep; `HostDrain.run` ends it
        try:
            if (other := await others.move(own, host)) is host:
                break
            host = other
            continue
        except (ChannelNotFound, QueueNotFound):  # deleted meanwhile
            break
        except StampedeError as error:
            unmoved[own.id] = str(error)
            if error.reason == "SHUTTING_DOWN":
                others.leave_out(host)
            elif not _may_succeed_later(error):
                return
        host = others.after(own, host)
        await asyncio.sleep(delay_s)
        delay_s = min(2 * delay_s, RETRY_SECONDS_MAX)
    if host is not None or not own.is_here:
        unmoved.pop(own.id, None)


def _log_outcome(moved: int, unmoved: dict[OwnSubject, str], *, is_last: bool) -> None:
    """Log the outcome. `unmoved`: the channels and queues that are still here, with the reasons. `is_last`: the host
    stops after the drain."""
    archived = [one for one in unmoved if is_last and one.needs_archive]
    stuck = [one for one in unmoved if not is_last or not (one.needs_archive or one.is_empty)]
    if archived:
        logger.info(
            "%s did not move to another host: the archive of this host has the items",
            _counted(archived), extra={"event": "recorded_channels_not_moved", **_named(archived)},
        )  # fmt: skip
    if stuck:
        end = "the host stops, and items that no other host has are lost" if is_last else "this host keeps the items"
        logger.warning(
            "%s could not move to another host (%s); %s", _counted(stuck), unmoved[stuck[0]], end,
            extra={"event": "channels_not_moved", **_named(stuck)},
        )  # fmt: skip
    if moved and not unmoved:
        logger.info("all channels have moved to other hosts", extra={"event": "host_drained", "channels": moved})


def _counted(subjects: Sequence[OwnSubject]) -> str:
    """The numbers of channels and queues, such as "1 channel and 2 queues"."""
    queues = sum(one.is_queue for one in subjects)
    counts = (("channel", len(subjects) - queues), ("queue", queues))
    return " and ".join(f"{count} {noun}{'' if count == 1 else 's'}" for noun, count in counts if count)


def _named(subjects: Sequence[OwnSubject]) -> dict[str, str | int]:
    names = ", ".join(one.name for one in subjects[:NAMES_LOGGED_MAX])
    return {"channels": names, "count": len(subjects)}


def _may_succeed_later(error: StampedeError) -> bool:
    """Whether a move that failed with this error may succeed later, at this or another host."""
    # this host allows a move at one epoch, and may have got another epoch since then
    is_of_former_epoch = isinstance(error, PermissionDenied) and "host_id" in error.metadata
    return is_of_former_epoch or isinstance(error, _RETRYABLE)
