"""All errors of the product. Clients and services use the same classes. Pure.

Each error has a `reason` (a value of `stampede_rt.v1.ErrorReason` without its prefix), and `metadata` with the details.
Its text names the thing, the reason and the way out.
"""

from __future__ import annotations

from collections.abc import Mapping


class StampedeError(Exception):
    """The base of all errors.

    `retryable`: the same call may succeed later, or after the client has looked for the host again. `from_service`: a
    service answered a call with this error.
    """

    reason: str = "INTERNAL"
    retryable: bool = False
    from_service: bool = False

    def __init__(self, message: str, *, reason: str | None = None, metadata: Mapping[str, str] | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.metadata: dict[str, str] = dict(metadata or {})
        if reason is not None:
            self.reason = reason

    def concerning(self, kind: str, name: str) -> None:
        """Add the kind and name of the thing, such as "channel" and its name, to the message if it lacks them."""
        if name not in self.message:
            self.message = f"{kind} {name!r}: {self.message}"
            self.args = (self.message,)
        self.metadata.setdefault(kind, name)


class InvalidArgument(StampedeError, ValueError):
    """A value is missing, of the wrong kind, or out of its range."""

    reason = "INVALID_ARGUMENT"


class InvalidInterval(InvalidArgument):
    """An interval has two instants as its bounds, and the start is after the end."""

    reason = "INVALID_INTERVAL"


class AheadOfClock(InvalidArgument):
    """A read is as of an instant that is ahead of the host's clock.

    `metadata["host_time_unix_nano"]` is that clock, in nanoseconds since the epoch.
    """

    reason = "AHEAD_OF_CLOCK"


class InvalidName(InvalidArgument):
    """A name does not match `[A-Za-z0-9][A-Za-z0-9._/-]{0,127}`."""

    reason = "INVALID_NAME"


class MalformedRun(InvalidArgument):
    """The columns of an item run disagree."""

    reason = "MALFORMED_RUN"


class ItemTooLarge(InvalidArgument):
    """The item is larger than a channel can hold, or than one gRPC message can carry."""

    reason = "ITEM_TOO_LARGE"


class CodecError(InvalidArgument):
    """A codec cannot encode a value, or cannot decode a payload."""


class FileError(StampedeError):
    """A file of a recording cannot be read or written. Only the client raises this error."""

    reason = "FILE_ERROR"


class ChannelNotFound(StampedeError, LookupError):
    """No channel has that name or id. Someone may have deleted it."""

    reason = "CHANNEL_NOT_FOUND"


class ChannelExists(StampedeError):
    """The channel exists with another policy, or at another host, than the caller stated."""

    reason = "CHANNEL_EXISTS"


class GroupNotFound(StampedeError, LookupError):
    """No group has that name or id. Someone may have deleted it."""

    reason = "GROUP_NOT_FOUND"


class GroupExists(StampedeError):
    """The group exists with other members or settings than the caller stated."""

    reason = "GROUP_EXISTS"


class QueueNotFound(StampedeError, LookupError):
    """No queue or mailbox has that name or id. Someone may have deleted the queue, or the mailbox's peer has left."""

    reason = "QUEUE_NOT_FOUND"


class QueueExists(StampedeError):
    """The queue exists with another policy, or at another host, than the caller stated."""

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
    """A channel or queue is full, and no room became free in time: a ChannelFull or a QueueFull."""


class ChannelFull(Full):
    """The channel is full and no room became free in time, or all its consumer places are taken."""

    reason = "CHANNEL_FULL"


class QueueFull(Full):
    """The queue or mailbox is full and no room became free in time. Leased messages count, too."""

    reason = "QUEUE_FULL"


class NotReplicated(StampedeError):
    """The channel has accepted the item, but too few replicas had it in time.

    Readers see the item as soon as it is replicated. If the host is lost before that, the item may be lost. If the
    program puts the item again, readers may get it twice. `metadata["seq"]` is the seq of the item.
    """

    reason = "NOT_REPLICATED"


class NotArchived(StampedeError):
    """The put waits for stable storage (ack="disk"), and the archive of the channel could not take the item.

    With `metadata["seq"]` the channel has accepted the item: readers see it, and the host tries again to archive it. If
    the host is lost before that, the item may be lost. If the program puts the item again, readers may get it twice.
    Without `metadata["seq"]` the channel has not accepted the item.
    """

    reason = "NOT_ARCHIVED"


class TooOld(StampedeError):
    """The item's time is too early for the channel: before the frontier or an advance, or older than `max_age`."""

    reason = "TOO_OLD"


class InFuture(StampedeError):
    """The item's time is further ahead of the host's clock than the channel allows."""

    reason = "IN_FUTURE"


class IncarnationLost(StampedeError):
    """The channel's host was lost with its items. Seqs and cursors from before the loss are no longer valid."""

    reason = "INCARNATION_LOST"


class LeaseExpired(StampedeError):
    """A lease has ended, or the caller never had the lease."""

    reason = "LEASE_EXPIRED"


class StaleRegistration(StampedeError):
    """Another process of the same peer or host has registered with this registration epoch or a higher one."""

    reason = "STALE_REGISTRATION"


class PermissionDenied(StampedeError):
    """The caller's secret, certificate or token is missing or wrong, or a rule of access denies the operation."""

    reason = "PERMISSION_DENIED"


class Overloaded(StampedeError):
    """The server has reached one of its bounds, or the caller has reached one of its quotas. Try again later.

    `retryable` is False for the quotas `channels`, `queues`, `groups` and `bytes-archived`, and if the archive of a
    host is full: there is no room until someone deletes something.
    """

    reason = "OVERLOADED"
    retryable = True

    def __init__(self, message: str, *, reason: str | None = None, metadata: Mapping[str, str] | None = None) -> None:
        super().__init__(message, reason=reason, metadata=metadata)
        is_lasting = self.metadata.get("quota") in ("channels", "queues", "groups", "bytes-archived")
        self.retryable = not is_lasting and "archive_bytes_max" not in self.metadata

    @property
    def is_over_open_streams(self) -> bool:
        """Whether the caller has as many open streams or subscriptions as its quota allows."""
        return self.metadata.get("quota") in ("streams", "subscriptions")


class Unavailable(StampedeError, ConnectionError):
    """The service cannot be reached, or cannot serve at present."""

    reason = "NO_QUORUM"
    retryable = True


class WrongCluster(Unavailable):
    """A supernode, host or front-end belongs to another cluster than the caller. Try another address."""

    reason = "WRONG_CLUSTER"


class DeadlineExceeded(StampedeError, TimeoutError):
    """The call's time was over before the server had answered. The server may still do the work."""

    reason = "DEADLINE_EXCEEDED"


class MoveConflict(StampedeError):
    """Another move of the channel is under way. Wait until it is over, and move the channel again if necessary."""

    reason = "MOVE_CONFLICT"
    retryable = True


class StaleBinding(StampedeError):
    """A cached binding no longer holds. The client looks for the host again (paper, section 4.2)."""

    reason = "NOT_HERE"
    retryable = True


class NotLeader(StampedeError):
    """This supernode does not lead. `metadata["leader_endpoint"]` names the leader, if it is known."""

    reason = "NOT_LEADER"
    retryable = True


class ForkedProcess(StampedeError, RuntimeError):
    """A forked process inherited the connection, which does not work there. Only the client raises this error."""

    reason = "FORKED_PROCESS"


class WrongEventLoop(StampedeError, RuntimeError):
    """A program used an asyncio connection on another event loop than the connection's. Only the client raises this."""

    reason = "WRONG_EVENT_LOOP"


class VersionMismatch(StampedeError):
    """The client and the server, or two servers, have versions of the protocol that do not work together."""

    reason = "VERSION_MISMATCH"


class WatchRestart(StampedeError):
    """The directory no longer keeps all changes since the watch broke, or has begun anew. List again, and begin a new
    watch.
    """

    reason = "WATCH_RESTART"


# The class of the exception for each reason.
_BY_REASON: dict[str, type[StampedeError]] = {
    cls.reason: cls
    for cls in (
        InvalidArgument, InvalidInterval, AheadOfClock, InvalidName, MalformedRun, ItemTooLarge, ChannelNotFound,
        ChannelExists, GroupNotFound, GroupExists, QueueNotFound, QueueExists, PeerNotFound, PeerExists, HostNotFound,
        HostExists,
        ChannelFull, QueueFull, NotReplicated, NotArchived, TooOld, InFuture, IncarnationLost, LeaseExpired,
        StaleRegistration, PermissionDenied, Overloaded, Unavailable, DeadlineExceeded, MoveConflict, StaleBinding,
        NotLeader, VersionMismatch, WatchRestart, WrongCluster,
    )
}  # fmt: skip
_BY_REASON |= {
    "NO_HOST": Unavailable,
    "CERTIFICATE_EXPIRED": Unavailable,
    "TOKEN_EXPIRED": Unavailable,
    "AMBIGUOUS": Unavailable,
    "SHUTTING_DOWN": Unavailable,
    "WRONG_EPOCH": StaleBinding,
    "MOVED": StaleBinding,
    "UNAUTHENTICATED": PermissionDenied,
}


def error_for(reason: str, message: str, metadata: Mapping[str, str] | None = None) -> StampedeError:
    """Return the exception for `reason`; a plain StampedeError if this release does not know the reason."""
    return _BY_REASON.get(reason, StampedeError)(message, reason=reason, metadata=metadata)
