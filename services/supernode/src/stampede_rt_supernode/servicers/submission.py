"""Repeats commands and confirmed reads until their outcome is known, so that they survive a change of the leader."""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from stampede_rt import errors
from stampede_rt_supernode.codecs.command_codec import decode_result, encode_command
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation, Result, Success
from stampede_rt_supernode.joining.members import why_diverged
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import LogUnavailable, OutcomeUnknown, ReplicatedLog, ReplicationStatus

ATTEMPT_SECONDS_MAX = 2.0
BACKOFF_SECONDS_MIN = 0.02
BACKOFF_SECONDS_MAX = 0.5
UNDER_WAY_OF_ONE_MAX = 500
"""The most commands of one caller that may wait for the log at this supernode. The log accepts 1000 of all callers."""

T = TypeVar("T")
R = TypeVar("R", bound=Success)


class Submission:
    """Submits commands to the log. Every wait ends within the `seconds` that the caller gives."""

    def __init__(self, log: ReplicatedLog, replica: DirectoryReplica, *, time_unix_nano: Callable[[], int]) -> None:
        self._log = log
        self._replica = replica
        self._time_unix_nano = time_unix_nano
        self._closed = False
        self._under_way: Counter[str] = Counter()  # by the caller's name; "" for all callers without a name

    def close(self) -> None:
        """Repeat nothing from now on.

        Calls under way end with their present attempt, with SHUTTING_DOWN if it fails.
        """
        self._closed = True

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
        """Replicate `operation`, and return its result, a `kind`. The directory performs it only once for each `op_id`.

        `as_of_index`, `caller`: see Command. Raises the error of the directory's refusal. Raises VersionMismatch if the
        command needs a higher feature level than the cluster's. Raises Unavailable with reason AMBIGUOUS if the log did
        not say whether the operation is done. If it is certainly not done, the reason is NO_QUORUM, or SHUTTING_DOWN if
        this supernode stops or its state has diverged. Raises Overloaded if the caller has too many commands under way.
        """
        with self._counted(caller):
            return await self._submit(operation, kind, op_id, seconds, as_of_index, caller)

    @contextmanager
    def _counted(self, caller: str) -> Iterator[None]:
        """Count a command of the caller. Raises Overloaded if a caller with a name has too many commands under way."""
        if caller and self._under_way[caller] >= UNDER_WAY_OF_ONE_MAX:
            raise errors.Overloaded(
                f"{UNDER_WAY_OF_ONE_MAX} changes of {caller} are under way at this supernode, the most for one caller; "
                "make fewer changes at the same time",
                metadata={"subject": caller, "limit": str(UNDER_WAY_OF_ONE_MAX)},
            )
        self._under_way[caller] += 1
        try:
            yield
        finally:
            self._under_way[caller] -= 1
            if not self._under_way[caller]:
                del self._under_way[caller]

    async def _submit(
        self, operation: Operation, kind: type[R], op_id: bytes, seconds: float, as_of_index: int, caller: str
    ) -> R:
        deadline = time.monotonic() + seconds
        now = self._time_unix_nano()
        command = Command(op_id=op_id, time_unix_nano=now, operation=operation, as_of_index=as_of_index, caller=caller)
        encoded = encode_command(command)
        if not self._replica.takes(encoded):
            await self.confirm(seconds=seconds)  # the level may have risen, while this supernode lags behind
            self._check_level(encoded)
        result = await self._persist(lambda timeout: self._propose(encoded, timeout), seconds, deadline)
        if isinstance(result, RefusedOperation):
            raise result.error()
        if not isinstance(result, kind):
            raise errors.StampedeError(f"a {type(operation).__name__} gave a {type(result).__name__}; report this")
        return result

    def check_level(self, what: str, needed: int) -> None:
        """Raises VersionMismatch if the cluster's feature level is below `needed`.

        `what`: the thing that needs the level, for the text of the error.
        """
        if self._replica.feature_level < needed:
            raise above_level(what, needed, self._log.status())

    def _check_level(self, encoded: bytes) -> None:
        if not self._replica.takes(encoded):
            kind = self._replica.kind_in(encoded)
            raise above_level(kind, self._replica.level_needed(kind), self._log.status())

    async def _propose(self, encoded: bytes, timeout: float) -> Result:
        result = decode_result(await self._log.propose(encoded, timeout=timeout))
        if isinstance(result, RefusedOperation) and result.reason == "NO_QUORUM":
            raise LogUnavailable(result.message)  # the cluster has just been founded, see `check_founded`
        return result

    async def confirm(self, *, seconds: float) -> int:
        """Wait until the local state includes every update that was acknowledged before the call.

        Raises Unavailable with reason NO_QUORUM or SHUTTING_DOWN.
        """
        deadline = time.monotonic() + seconds
        return await self._persist(lambda timeout: self._log.confirm_read(timeout=timeout), seconds, deadline)

    def check_state(self) -> None:
        """Raises Unavailable with reason SHUTTING_DOWN if this supernode's state has diverged."""
        status = self._log.status()
        if status.diverged_at:
            text = f"{why_diverged(status)}; it serves no caller until it has joined again; use another one"
            raise errors.Unavailable(text, reason="SHUTTING_DOWN")

    async def _persist(self, attempt: Callable[[float], Awaitable[T]], seconds: float, deadline: float) -> T:
        """Repeat `attempt` until `deadline`. The errors name `seconds`, the time that the caller gave."""
        self.check_state()
        backoff, ambiguous = BACKOFF_SECONDS_MIN, False
        while (seconds_left := deadline - time.monotonic()) > 0 and not self._closed:
            try:
                return await attempt(min(seconds_left, ATTEMPT_SECONDS_MAX))
            except LogUnavailable:
                pass  # certainly not done by this attempt; an earlier attempt may still be under way
            except OutcomeUnknown:
                ambiguous = True
            seconds_left = deadline - time.monotonic()
            await asyncio.sleep(max(0.0, min(seconds_left, backoff * random.uniform(0.5, 1.0))))
            backoff = min(2 * backoff, BACKOFF_SECONDS_MAX)
        if ambiguous:
            raise _unknown(seconds)
        raise _shutting_down() if self._closed else _no_quorum(seconds)


def above_level(kind: str, needed: int, status: ReplicationStatus) -> errors.VersionMismatch:
    """The error for a command that needs a higher feature level than the cluster's.

    Names the members that lack the level.
    """
    levels = {member.member_id: status.highest_levels.get(member.member_id) for member in status.members}
    behind = [name for name, level in sorted(levels.items()) if level is None or level < needed]
    named = ", ".join(f"{name} ({'no report' if levels[name] is None else f'level {levels[name]}'})" for name in behind)
    way_out = f"upgrade {named} (runbook: upgrade)" if behind else "all supernodes know it by now: try again soon"
    return errors.VersionMismatch(
        f"{kind} needs feature level {needed}, the cluster is at level {status.feature_level}, and nothing was done; "
        f"{way_out}; the level rises by itself when all supernodes run a release that knows it",
        metadata={
            "command": kind,
            "feature_level_needed": str(needed),
            "feature_level": str(status.feature_level),
            "supernodes_behind": ",".join(behind),
        },
    )


def _unknown(seconds: float) -> errors.Unavailable:
    return errors.Unavailable(
        f"the supernodes did not say within {seconds:.1f} s whether the update is done; try again with the same "
        "request id, which does it once",
        reason="AMBIGUOUS",
    )


def _no_quorum(seconds: float) -> errors.Unavailable:
    return errors.Unavailable(
        f"no majority of the supernodes answered within {seconds:.1f} s; try another supernode, or make sure that "
        "most of them run and reach each other",
        reason="NO_QUORUM",
    )


def _shutting_down() -> errors.Unavailable:
    return errors.Unavailable("this supernode is about to stop; use another one", reason="SHUTTING_DOWN")
