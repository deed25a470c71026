"""Every error of the system, on both sides of the wire. Pure.

Each carries a `reason` (a value of `stampede_rt.v1.ErrorReason` without its prefix), a sentence that names the thing,
the reason and the way out, and `metadata` with the thing's particulars.
"""

from __future__ import annotations

from collections.abc import Mapping


class StampedeError(Exception):
    """The root. `retryable` says that the same call may succeed after resolving the channel again or waiting."""

    reason: str = "INTERNAL"
    retryable: bool = False

    def __init__(self, message: str, *, reason: str | None = None, metadata: Mapping[str, str] | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.metadata: dict[str, str] = dict(metadata or {})
        if reason is not None:
            self.reason = reason

    def concerning(self, kind: str, name: str) -> None:
        """Name the thing, such as "channel" and its name, unless the message does already."""
        if name not in self.message:
            self.message = f"{kind} {name!r}: {self.message}"
            self.args = (self.message,)
        self.metadata.setdefault(kind, name)


class InvalidArgument(StampedeError, ValueError):
    """A value is missing, of the wrong kind, or out of its range."""

    reason = "INVALID_ARGUMENT"


class InvalidInterval(InvalidArgument):
    """A concrete lower bound lies above a concrete upper one."""

    reason = "INVALID_INTERVAL"


class InvalidName(InvalidArgument):
    """A name does not match `[A-Za-z0-9][A-Za-z0-9._/-]{0,127}`."""

    reason = "INVALID_NAME"


class MalformedRun(InvalidArgument):
    """The columns of an item run disagree."""

    reason = "MALFORMED_RUN"


class ItemTooLarge(InvalidArgument):
    """One item is larger than its channel, or one message, can hold."""

    reason = "ITEM_TOO_LARGE"


class CodecError(InvalidArgument):
    """A value cannot be encoded, or a payload is not what its reader's codec decodes."""


class ChannelNotFound(StampedeError, LookupError):
    """No channel has that name or id; it may have been deleted."""

    reason = "CHANNEL_NOT_FOUND"


class ChannelExists(StampedeError):
    """The channel is there with a set-up that contradicts the one stated."""

    reason = "CHANNEL_EXISTS"


class GroupNotFound(StampedeError, LookupError):
    """No group has that name or id; it may have been deleted."""

    reason = "GROUP_NOT_FOUND"


class GroupExists(StampedeError):
    """The group is there with other members or another reference."""

    reason = "GROUP_EXISTS"


class QueueNotFound(StampedeError, LookupError):
    """No queue has that name or id; it may have been deleted, or be the mailbox of a peer that has left."""

    reason = "QUEUE_NOT_FOUND"


class QueueExists(StampedeError):
    """The queue is there with a set-up that contradicts the one stated."""

    reason = "QUEUE_EXISTS"


class PeerNotFound(StampedeError, LookupError):
    """No live peer has that name or id."""

    reason = "PEER_NOT_FOUND"


class PeerExists(StampedeError):
    """Another live peer has that name."""

    reason = "PEER_EXISTS"


class HostNotFound(StampedeError, LookupError):
    """No live host has that name or id."""

    reason = "HOST_NOT_FOUND"


class HostExists(StampedeError):
    """Another live host has that name."""

    reason = "HOST_EXISTS"


class Full(StampedeError):
    """A limit is reached, and nothing made room in time: a ChannelFull or a QueueFull."""


class ChannelFull(Full):
    """The channel's limits are reached and nothing made room in time, or all places of its consumers are taken."""

    reason = "CHANNEL_FULL"


class QueueFull(Full):
    """The limits of the queue or mailbox are reached and nothing made room in time. Leased messages take room, too."""

    reason = "QUEUE_FULL"


class TooOld(StampedeError):
    """The item lies behind the retention window, behind what was collected, or below an advance."""

    reason = "TOO_OLD"


class InFuture(StampedeError):
    """The item lies further ahead of the host's clock than the channel allows."""

    reason = "IN_FUTURE"


class IncarnationLost(StampedeError):
    """The channel's host was lost and items with it: seqs and cursors from before do not hold any more."""

    reason = "INCARNATION_LOST"


class LeaseExpired(StampedeError):
    """A lease has ended, or was never held."""

    reason = "LEASE_EXPIRED"


class PermissionDenied(StampedeError):
    """The secret or certificate is missing or wrong, or the caller may not do this."""

    reason = "PERMISSION_DENIED"


class Overloaded(StampedeError):
    """A bound of the server is reached."""

    reason = "OVERLOADED"
    retryable = True


class Unavailable(StampedeError, ConnectionError):
    """The service cannot be reached, or cannot serve at present."""

    reason = "NO_QUORUM"
    retryable = True


class DeadlineExceeded(StampedeError, TimeoutError):
    """The call's time is over before the work was done."""

    reason = "DEADLINE_EXCEEDED"


class StaleBinding(StampedeError):
    """A cached place of a channel does not hold any more; treated as a cache miss (paper, section 4.2)."""

    reason = "NOT_HERE"
    retryable = True


class NotLeader(StampedeError):
    """This supernode does not lead; `metadata["leader_endpoint"]` names the one that does, if known."""

    reason = "NOT_LEADER"
    retryable = True


class ForkedProcess(StampedeError, RuntimeError):
    """The process was forked, and what it inherited does not work in it. The client alone raises it."""

    reason = "FORKED_PROCESS"


class VersionMismatch(StampedeError):
    """The two sides speak versions that do not go together."""

    reason = "VERSION_MISMATCH"


class WatchRestart(StampedeError):
    """The changes asked for are not kept any more: list again, then watch from there."""

    reason = "WATCH_RESTART"


_BY_REASON: dict[str, type[StampedeError]] = {
    cls.reason: cls
    for cls in (
        InvalidArgument, InvalidInterval, InvalidName, MalformedRun, ItemTooLarge, ChannelNotFound, ChannelExists,
        GroupNotFound, GroupExists, QueueNotFound, QueueExists, PeerNotFound, PeerExists, HostNotFound, HostExists,
        ChannelFull, QueueFull, TooOld, InFuture, IncarnationLost, LeaseExpired, PermissionDenied, Overloaded,
        Unavailable, DeadlineExceeded, StaleBinding, NotLeader, VersionMismatch, WatchRestart,
    )
}  # fmt: skip
_BY_REASON |= {
    "NO_HOST": Unavailable,
    "AMBIGUOUS": Unavailable,
    "SHUTTING_DOWN": Unavailable,
    "WRONG_EPOCH": StaleBinding,
    "MOVED": StaleBinding,
    "UNAUTHENTICATED": PermissionDenied,
}


def error_for(reason: str, message: str, metadata: Mapping[str, str] | None = None) -> StampedeError:
    """The exception that stands for `reason`; an unknown reason of a newer server is a plain StampedeError."""
    return _BY_REASON.get(reason, StampedeError)(message, reason=reason, metadata=metadata)
