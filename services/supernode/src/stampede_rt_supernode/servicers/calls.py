"""The common parts of the servicers: deadlines, reads and updates of the directory, and checks of the caller."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

from stampede_rt.cluster.request_age import request_age_nanos
from stampede_rt.errors import InvalidArgument, Overloaded
from stampede_rt_runtime.access.control import (
    check_access,
    check_known,
    check_not_judged,
    count_refusal,
    current_account,
    own_name,
    owner_name,
)
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.admission import caller_identity
from stampede_rt_runtime.rpc import Context
from stampede_rt_supernode.core import commands
from stampede_rt_supernode.core.access.queries import right_to_open, thing_with
from stampede_rt_supernode.core.callers import check_host_caller
from stampede_rt_supernode.core.channels.commands import OpenChannel
from stampede_rt_supernode.core.command_table import check_operation, subject_of
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.groups.commands import OpenGroup
from stampede_rt_supernode.core.kept_answers import REPEAT_NANOS_MAX
from stampede_rt_supernode.core.peers.checks import check_owner
from stampede_rt_supernode.core.queues.commands import OpenQueue
from stampede_rt_supernode.core.records import PeerRecord
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.servicers.submission import Submission

# The longest time that a call waits for the other supernodes, even if the caller's deadline is later.
WAIT_SECONDS_MAX = 10.0
# This time is subtracted from the caller's deadline, so that the caller gets the reason and not only a deadline error.
ANSWER_SECONDS = 0.1

T = TypeVar("T")
S = TypeVar("S", bound=commands.Success)
Op = TypeVar("Op", bound=commands.Operation)


def seconds_left(context: Context) -> float:
    """The seconds that this call may wait for the other supernodes."""
    call_seconds = context.time_remaining()
    if call_seconds is None:
        return WAIT_SECONDS_MAX
    return float(min(WAIT_SECONDS_MAX, max(call_seconds - ANSWER_SECONDS, call_seconds / 2)))


def check_age(context: Context) -> None:
    """Raises InvalidArgument for a request that was first sent so long ago that its answer is forgotten."""
    age_nanos = request_age_nanos(context.invocation_metadata())
    if age_nanos >= REPEAT_NANOS_MAX:
        raise InvalidArgument(
            f"the request was first sent {age_nanos / 1e9:.0f} s ago; answers are remembered for "
            f"{REPEAT_NANOS_MAX / 1e9:.0f} s, so the request might be done twice; look at its result, and send it "
            "again under a new request id if it is still wanted"
        )


class DirectoryCalls:
    """The reads and updates of one supernode. Reads are linearizable unless `stale_ok` is set.

    The directory performs an update only once for each request id.
    """

    def __init__(self, replica: DirectoryReplica, submission: Submission) -> None:
        self._replica = replica
        self._submission = submission

    async def read(self, context: Context, query: Callable[[Directory], T], *, stale_ok: bool = False) -> T:
        """The result of `query`, called with the directory.

        `stale_ok`: do not wait for a majority; the state may then lack the latest updates. Raises Unavailable with
        reason NO_QUORUM or SHUTTING_DOWN.
        """
        self._submission.check_state()
        if not stale_ok:
            await self._submission.confirm(seconds=seconds_left(context))
        return self._replica.read(query)

    async def submit(
        self,
        context: Context,
        operation: commands.Operation,
        kind: type[S],
        op_id: bytes,
        as_of_index: int | None = None,
    ) -> S:
        """The result of `operation`. Raises the errors of `check_operation`, `check_age` and `Submission.submit`.

        `as_of_index`: the result of `applied_index` when this supernode received the request; None: take it now.
        """
        check_id(op_id, "request_id")
        check_operation(operation)
        check_age(context)
        current_account().change()
        as_of_index = self.applied_index() if as_of_index is None else as_of_index
        try:
            return await self._submission.submit(
                operation,
                kind,
                op_id=op_id,
                seconds=seconds_left(context),
                as_of_index=as_of_index,
                caller=own_name(),
            )
        except Overloaded as error:
            count_refusal(error)
            raise

    async def open(
        self,
        context: Context,
        operation: Op,
        kind: type[S],
        op_id: bytes,
        *,
        as_of_index: int,
        unchanged: Callable[[Tables, Op], S | None],
        check: Callable[[Op], Awaitable[object]],
    ) -> S:
        """Submit an operation that opens a thing, see `submit`.

        A first request that changes nothing gets its answer from a confirmed read, without a log entry. A repeated
        request gets an entry, unless the directory remembers its answer, because the network may still delay the first
        attempt. The delayed attempt then finds that answer. So it opens nothing after another caller has deleted the
        thing.

        `unchanged`: returns the answer if the thing exists in the requested form; otherwise None. `check`: is awaited
        before the entry is proposed, and raises for a forbidden operation.
        """
        check_id(op_id, "request_id")
        is_repeated = request_age_nanos(context.invocation_metadata()) > 0

        def find(directory: Directory) -> S | None:
            found = directory.kept_answers.find(op_id, subject_of(operation))
            if isinstance(found, kind):
                return found
            return None if is_repeated else unchanged(directory.tables, operation)

        opened = await self.read(context, find)
        if opened is not None:
            return opened
        await check(operation)
        return await self.submit(context, operation, kind, op_id, as_of_index)

    async def check_level(self, context: Context, what: str, needed: int) -> None:
        """Raises VersionMismatch if the cluster's feature level is below `needed`.

        `what`: names the use in the error.
        """
        await self.confirm(context)
        self._submission.check_level(what, needed)

    async def confirm(self, context: Context) -> None:
        """Wait until the local state includes every update that was acknowledged before the call.

        Raises Unavailable with reason NO_QUORUM or SHUTTING_DOWN.
        """
        await self._submission.confirm(seconds=seconds_left(context))

    def applied_index(self) -> int:
        """The log position of this replica's state, at least 1.

        Call it when a request comes in, see `core.kept_answers`.
        """
        return max(1, self._replica.read(lambda directory: directory.applied_index))

    def check_opening(self, kind: AccessKind, operation: OpenChannel | OpenQueue | OpenGroup) -> bool:
        """Check the caller's right if an open creates the thing or changes its settings.

        Returns whether the open does so. Raises PermissionDenied.
        """
        verb = self._replica.read(lambda directory: right_to_open(directory.tables, operation))
        if verb is not None:
            check_access(verb, kind, operation.name)
        return verb is not None

    async def check_thing(self, context: Context, verb: AccessVerb, kind: AccessKind, thing_id: bytes) -> None:
        """Check the access to the thing with that id. For a mailbox, check instead that the caller owns its peer.

        Ignores a missing thing, for which the operation itself has an error. A thing that this replica does not know
        yet counts as missing only after a confirmed read, because the operation may find it. Raises PermissionDenied,
        and Unavailable with reason NO_QUORUM.
        """
        await self.check_things(context, verb, kind, [thing_id])

    async def check_things(
        self, context: Context, verb: AccessVerb, kind: AccessKind, thing_ids: Sequence[bytes]
    ) -> None:
        """Check a limited number of things like `check_thing`, with one confirmed read at most."""

        def find(directory: Directory) -> list[str | PeerRecord | None]:
            return [thing_with(directory.tables, kind, one) for one in thing_ids]

        things = self._replica.read(find)
        if None in things:
            things = await self.read(context, find)
        for found in things:
            if isinstance(found, PeerRecord):
                self._check_owner(found)
            elif found is not None:
                check_known(kind, found, by_id=True)
                check_access(verb, kind, found)

    async def _known(self, context: Context, query: Callable[[Directory], T | None]) -> T | None:
        """The result of `query` on the local state; if that is None, its result after a confirmed read."""
        found = self._replica.read(query)
        return await self.read(context, query) if found is None else found

    def holder_of(self, name: str) -> PeerRecord | None:
        """The live peer of that name, as this replica knows it; None if it knows none."""
        return self._replica.read(lambda directory: directory.tables.peers.live_named(name))

    async def check_peer(self, context: Context, peer_id: bytes) -> None:
        """Raises PermissionDenied if another caller registered that peer, and Unavailable with reason NO_QUORUM."""
        peer = await self._known(context, lambda directory: directory.tables.peers.by_id.get(peer_id))
        if peer is not None:
            self._check_owner(peer)

    @staticmethod
    def _check_owner(peer: PeerRecord) -> None:
        """Raises PermissionDenied if another caller registered that peer."""
        if peer.owner is not None and peer.owner != owner_name():
            check_known(AccessKind.PEER, peer.name or peer.peer_id.hex(), by_id=True)
        check_owner(peer, owner_name())

    def check_host(self, context: Context, host_id: bytes, name: str | None = None) -> None:
        """Raises PermissionDenied if the caller is a client, or has the certificate of another host.

        `name`: the name that the host wants.
        """
        caller = caller_identity(context)
        known = self._replica.read(lambda directory: directory.tables.hosts.get(host_id))
        check_host_caller(caller, registered_name=known.name if known else None, new_name=name)
        check_not_judged("speak for a host")
