"""The simulated cluster of the replicated log, with the production directory, leases and service on each member."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from stampede_rt import errors
from stampede_rt.cluster.request_age import age_metadata
from stampede_rt_supernode.codecs.command_codec import decode_result, encode_command
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation, Success
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import LogUnavailable, Member, OutcomeUnknown, ReplicationStatus
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.rules.proposals import Proposal
from stampede_rt_supernode.replication.settings import RaftTiming
from stampede_rt_supernode.replication.threads.tick_thread import STUCK_SECONDS
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.directory_servicer import DirectoryServicer
from stampede_rt_supernode.servicers.lease_keeper import TICK_SECONDS, LeaseKeeper
from stampede_rt_supernode.servicers.peer_servicer import PeerServicer
from stampede_rt_supernode.servicers.queue_servicer import QueueDirectoryServicer
from tests.robustness.directory.tasks import Resume, drive, wait
from tests.robustness.replication.fault_rates import FaultRates
from tests.robustness.replication.sim_member import SimMember
from tests.robustness.replication.world import TIMING, World
from tests.support.supernode.list_machine import PromiseBroken

LEASE_TTL_NANOS = 2 * 10**9
CLOCK_DRIFT_MAX = 0.02  # the drift of each machine's clock against true time: ten times the drift that NTP accepts
R = TypeVar("R", bound=Success)


class Clock:
    """A machine's clocks: one that drifts a little, and a wall clock that is sometimes set."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._rate = 1 + world.random_source.uniform(-CLOCK_DRIFT_MAX, CLOCK_DRIFT_MAX)
        self._offset = world.random_source.uniform(0, 1e6)
        self.wall_offset_nanos = 0

    def boottime_nanos(self) -> int:
        return int((self._offset + self._world.now * self._rate) * 1e9)

    def time_unix_nano(self) -> int:
        return max(0, 1_700_000_000_000_000_000 + self.boottime_nanos() + self.wall_offset_nanos)


class Submission:
    """Submit a command like `stampede_rt_supernode.servicers.submission`, in simulated time."""

    def __init__(self, member: DirectoryMember) -> None:
        self._member, self._world = member, member.world

    def check_state(self) -> None:
        """See `SimMember`. Ends the run if the state differs."""

    async def submit(
        self,
        operation: Operation,
        kind: type[R],
        *,
        op_id: bytes,
        seconds: float,
        as_of_index: int = 0,
        caller: str = "",
    ) -> R:
        stamp = self._member.clock.time_unix_nano()
        command = Command(
            op_id=op_id, time_unix_nano=stamp, operation=operation, as_of_index=as_of_index, caller=caller
        )
        encoded = encode_command(command)
        deadline, ambiguous = self._world.now + seconds, False
        while (left := deadline - self._world.now) > 0:
            outcome = await wait(lambda resume, left=left: self._propose(encoded, min(left, 2.0), resume))
            if isinstance(outcome, bytes):
                result = decode_result(outcome)
                if not (isinstance(result, RefusedOperation) and result.reason == "NO_QUORUM"):
                    return _checked(result, kind)
            ambiguous |= isinstance(outcome, OutcomeUnknown)
            await self._world.sleep(self._world.random_source.uniform(0.02, 0.3))
        raise errors.Unavailable("not within the time", reason="AMBIGUOUS" if ambiguous else "NO_QUORUM")

    async def confirm(self, *, seconds: float) -> int:
        deadline = self._world.now + seconds
        while (left := deadline - self._world.now) > 0:
            index = await wait(lambda resume, left=left: self._read(min(left, 2.0), resume))
            if index is not None:
                return int(index)
            await self._world.sleep(self._world.random_source.uniform(0.02, 0.3))
        raise errors.Unavailable("not within the time")

    def _later(self, resume: Resume) -> Resume:
        """Return a function that resumes through the event loop of the process, once the log's thread is back from its
        disk.
        """
        later = self._world.later(resume)
        return lambda value: self._member.after_disk(lambda: later(value))

    def _propose(self, encoded: bytes, timeout: float, resume: Resume) -> None:
        assert self._member.replica is not None
        later = self._later(resume)
        try:
            self._member.replica.propose(Proposal(encoded, self._world.now + timeout, later))
        except LogUnavailable as full:
            later(full)

    def _read(self, timeout: float, resume: Resume) -> None:
        assert self._member.replica is not None
        later = self._later(resume)
        try:
            self._member.replica.read(ConfirmedRead(self._world.now + timeout, later))
        except LogUnavailable:
            later(None)


def _checked(result: Any, kind: type[R]) -> R:
    if isinstance(result, RefusedOperation):
        raise result.error()
    assert isinstance(result, kind)
    return result


class _Log:
    """The methods of the log that the lease keeper uses."""

    def __init__(self, member: DirectoryMember) -> None:
        self.member = member

    def status(self) -> ReplicationStatus:
        assert self.member.replica is not None
        status = self.member.replica.status()
        if self.member.stuck_seconds > STUCK_SECONDS:  # as PySyncObjLog reports it
            return replace(status, leader_id=None, is_leader=False, tenure=0)
        return status


class _Leases(LeaseKeeper):
    """The production lease keeper. Its waits are replaced by waits that need no event loop."""

    _log: _Log  # type: ignore[assignment]

    async def _end_due_leases(self) -> None:
        now = self._clock.boottime_nanos()
        self._hosts.follow(self._replica.read(lambda directory: list(directory.tables.live_hosts())), now)
        if due := self._hosts.due(now):
            await wait(lambda resume: self._end_all(due, resume))

    @staticmethod
    async def _let_others_run() -> None:
        """Do nothing: there is no event loop."""

    def _end_all(self, due: list[tuple[bytes, int, int]], resume: Resume) -> None:
        left = len(due)

        async def end(lease: tuple[bytes, int, int]) -> None:
            nonlocal left
            with contextlib.suppress(errors.StampedeError):
                await self._end(*lease)
            left -= 1
            if not left:
                resume(None)

        for lease in due:
            self._log.member.run(lambda lease=lease: end(lease))


# A process of a host or peer: the holder of the lease, and its boot incarnation.
Process = tuple[bytes, int]


class WatchedDirectory(DirectoryReplica):
    """The production replica. It reports the processes that a command has taken out of the directory."""

    def __init__(self, ended: Callable[[int, set[Process]], None]) -> None:
        super().__init__()
        self._ended = ended

    def apply(self, index: int, command: bytes) -> bytes:
        """Do the same as in production."""
        before = self._alive()
        encoded = super().apply(index, command)
        self._ended(index, before - self._alive())
        return encoded

    def _alive(self) -> set[Process]:
        tables = self._directory.tables
        return {(one.holder_id, one.boot_incarnation) for one in (*tables.live_hosts(), *tables.peers.live())}


class DirectoryMember(SimMember):
    """One supernode: the member of the log, and its services. The state machine of its log is a directory."""

    world: DirectoryWorld
    _directory: DirectoryReplica

    def __init__(
        self, world: DirectoryWorld, member: Member, seeds: Sequence[Member], *, joining: bool = False
    ) -> None:
        self.clock = Clock(world)
        super().__init__(world, member, seeds, joining=joining)

    @property
    def machine(self) -> Any:
        return self._directory

    @machine.setter
    def machine(self, _: object) -> None:
        self._directory = WatchedDirectory(self.world.leases_ended)

    def start(self) -> None:
        super().start()
        submission = Submission(self)
        leases = self.world.leases(
            _Log(self),  # type: ignore[arg-type]  # the lease keeper calls only status()
            self._directory,
            submission,  # type: ignore[arg-type]  # the same methods
            clock=self.clock,
            founding_ttl_nanos=self.world.lease_ttl_nanos,
        )
        calls = DirectoryCalls(self._directory, submission)  # type: ignore[arg-type]
        self.services = (
            DirectoryServicer(self._directory, submission, leases, None, None, self.clock, None, None),  # type: ignore[arg-type]
            QueueDirectoryServicer(calls),
            PeerServicer(calls, leases, None),  # type: ignore[arg-type]  # this world has no watchers
        )
        self.run(lambda: self._tick(leases))

    def run(self, make: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Run a coroutine in this process. It ends with the process, and waits while the process is frozen."""
        process = self.replica
        drive(make, alive=lambda: self.replica is process, gate=self._when_awake)

    def _when_awake(self, call: Callable[[], None]) -> None:
        if self.frozen_until > self.world.now:
            self.world.at(self.frozen_until + self.world.random_source.random() * 0.001, call)
        else:
            call()

    async def _tick(self, leases: LeaseKeeper) -> None:
        while True:
            await leases.tick()
            await self.world.sleep(TICK_SECONDS)


class DirectoryWorld(World):
    """A World whose members serve the directory. `leases`: the class of the lease keepers. Another class plants
    faults.
    """

    members: dict[str, DirectoryMember]  # type: ignore[assignment]

    def __init__(
        self,
        seed: int,
        *,
        size: int,
        fault_rates: FaultRates,
        leases: type[LeaseKeeper] = _Leases,
        lease_ttl_nanos: int = LEASE_TTL_NANOS,
        timing: RaftTiming = TIMING,
    ) -> None:
        self.leases, self.lease_ttl_nanos = leases, lease_ttl_nanos
        # The callers that cannot reach a supernode at present.
        self.unreachable: set[tuple[object, str]] = set()
        # For each caller: the supernode that answered it last.
        self.last_answered: dict[object, DirectoryMember] = {}
        # Hosts and peers by id: whether the process of that boot incarnation counts on its lease at this moment.
        self.counts_on_lease: dict[bytes, Callable[[int], bool]] = {}
        # For each caller: the lowest registration epoch that the network holds, and the held registrations.
        self._held_from: dict[object, int] = {}
        self._held: dict[object, list[Callable[[], None]]] = {}
        self._applied_first = 0
        super().__init__(seed, size=size, fault_rates=fault_rates, timing=timing)
        self.members = {
            name: DirectoryMember(self, one.member, one.settings.initial_members) for name, one in self.members.items()
        }

    async def sleep(self, seconds: float) -> None:
        """Let simulated time pass."""
        await wait(lambda resume: self.after(seconds, lambda: resume(None)))

    def later(self, resume: Resume) -> Resume:
        """Return a function that calls `resume` a moment later, through the event loop of the process."""
        return lambda value: self.after(self.random_source.random() * 0.002, lambda: resume(value))

    def leases_ended(self, index: int, processes: set[Process]) -> None:
        """Check the processes that the command at this index has taken out of the directory. Raises PromiseBroken.

        Only the first member that applies the command shows when it was committed.
        """
        if index <= self._applied_first:
            return
        self._applied_first = index
        for one, boot in sorted(processes):
            if self.counts_on_lease[one](boot):
                raise PromiseBroken(f"command {index} ends the lease of {one.hex()}, which counts on it at this moment")

    def hold_registrations(self, caller: object, from_epoch: int) -> None:
        """From now on the network holds the registrations of `caller` with this registration epoch or a higher one."""
        self._held_from[caller] = from_epoch

    def held_registrations(self, caller: object) -> list[Callable[[], None]]:
        """Hold no further registrations. Returns a function for each held one, which lets it arrive."""
        self._held_from.pop(caller, None)
        return self._held.pop(caller, [])

    # -- calls -------------------------------------------------------------------------------------------------

    async def call(
        self,
        member: DirectoryMember,
        method: str,
        request: Any,
        timeout: float,
        *,
        caller: object = None,
        age_s: float = 0.0,
    ) -> Any:
        """Make one RPC over a bad network. Returns the response, the StampedeError, or None if no answer came in time.

        `age_s`: the time for which the caller has repeated the call.
        """
        way = (caller, member.member.member_id)
        return await wait(lambda resume: self._call(member, method, request, timeout, way, age_s, resume))

    def _call(
        self,
        member: DirectoryMember,
        method: str,
        request: Any,
        timeout: float,
        way: tuple[object, str],
        age_s: float,
        resume: Resume,
    ) -> None:
        self.after(timeout, lambda: resume(None))

        def answer(outcome: object) -> None:
            if way not in self.unreachable and (delay := self.trip()) is not None:
                self.after(delay, lambda: resume(outcome))

        def arrive() -> None:
            if member.replica is not None:
                service = next(one for one in member.services if hasattr(one, method))
                # As in gRPC: the caller sends its time limit, and the server counts from the arrival.
                context = _Context(self, self.now + timeout, age_s)
                member.run(lambda: _served(service, method, request, context, answer))

        if way not in self.unreachable and (delay := self.trip()) is not None:
            if getattr(request, "registration_epoch", -1) >= self._held_from.get(way[0], 2**64):
                self._held.setdefault(way[0], []).append(arrive)
            else:
                self.after(delay, arrive)

    def trip(self) -> float | None:
        """The time that a message between a caller and a service takes; None: it is lost."""
        if self.random_source.random() < self.fault_rates.loss / 2:
            return None
        slow = self.random_source.random() < 0.04
        return self.random_source.uniform(0.1, 3.0) if slow else self.random_source.expovariate(1 / 0.003)


class _Context:
    """The methods of a gRPC context that servicers use."""

    def __init__(self, world: DirectoryWorld, deadline: float, age_s: float) -> None:
        self._world, self._deadline, self._age_s = world, deadline, age_s

    def time_remaining(self) -> float:
        return max(0.0, self._deadline - self._world.now)

    def invocation_metadata(self) -> tuple[tuple[str, str], ...]:
        return age_metadata(self._age_s)

    def auth_context(self) -> dict[str, Any]:
        return {}

    async def abort(self, code: object, message: str, trailers: Any) -> None:
        raise _AbortedCall(code, message, trailers)


class _AbortedCall(Exception):
    """The RPC ended with an error. This exception has the status for the caller."""

    def trailing_metadata(self) -> Any:
        return self.args[2]


async def _served(
    service: object, method: str, request: Any, context: _Context, answer: Callable[[object], None]
) -> None:
    from stampede_rt.status import from_rpc_error

    try:
        answer(await getattr(service, method)(request, context))
    except _AbortedCall as error:
        answer(from_rpc_error(error, "simulated"))  # type: ignore[arg-type]  # it has the trailers
