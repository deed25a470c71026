"""The errors with which a host refuses requests for channels that it does not serve. Pure."""

from __future__ import annotations

from stampede_rt.errors import ChannelNotFound, IncarnationLost, MoveConflict, StampedeError, Unavailable, error_for

SHUTTING_DOWN = error_for(
    "SHUTTING_DOWN", "this host is shutting down; resolve the channel again for its new host, or wait for this one"
)


def fenced(host: str) -> StampedeError:
    """The error of a host that did not renew its lease in time. Another host may own the channels by now."""
    return error_for(
        "NOT_HERE",
        f"host {host} could not renew its lease in time and serves nothing until the lease is renewed; resolve the "
        "channel again, or wait",
        {"host": host},
    )


def not_here(host: str, channel_id: bytes) -> StampedeError:
    """The error for a channel that no caller has bound at this host, or that another host owns now."""
    shown = channel_id.hex()
    return error_for(
        "NOT_HERE",
        f"channel {shown} is not at host {host}; resolve it at the directory, then bind it at its host's gatekeeper",
        {"channel_id": shown, "host": host},
    )


def moved(name: str, host_id: bytes) -> StampedeError:
    """The error for a channel for which the directory names another owner."""
    shown = host_id.hex()
    return error_for(
        "MOVED", f"channel {name} is at host {shown} now; resolve it again", {"channel": name, "host_id": shown}
    )


def moved_to(name: str, host_id: bytes, target: str, epoch: int, spec_version: int) -> StampedeError:
    """The error that sends the callers of a channel to its new owner, with all that they need to bind it there."""
    return error_for(
        "MOVED",
        f"channel {name} has moved to the host at {target}; continue there",
        {
            "channel": name,
            "host_id": host_id.hex(),
            "target": target,
            "epoch": str(epoch),
            "spec_version": str(spec_version),
        },
    )


def move_conflict(name: str) -> StampedeError:
    """The error for a move of a channel of which another move is under way."""
    return MoveConflict(
        f"another move of channel {name} is under way; wait until it is over", metadata={"channel": name}
    )


def not_ready(name: str) -> StampedeError:
    """The error of a new owner that waits for the replicas in sync, or for the directory."""
    return Unavailable(
        f"channel {name} has a new owner, which waits for the replicas; try again", metadata={"channel": name}
    )


def policy_after_move(name: str) -> StampedeError:
    """The error of a channel that gets its new policy only when the move that is under way has ended."""
    text = (
        f"channel {name} is about to move to another host, and gets its new policy when the move has ended; try again"
    )
    return Unavailable(text, metadata={"channel": name})


def copy_cannot(name: str, why: str) -> StampedeError:
    """The error of a copy that cannot serve a request. The owner can."""
    return error_for("MOVED", f"the copy of channel {name} at this host {why}; ask the owner", {"channel": name})


def to_copy(name: str, host_id: bytes, target: str) -> StampedeError:
    """The error that sends a reader to a copy of the channel."""
    return error_for(
        "MOVED",
        f"the copy of channel {name} at {target} has fewer readers; continue there, or ask again with stay",
        {"channel": name, "host_id": host_id.hex(), "copy_target": target},
    )


def wrong_epoch(name: str, stated: int, actual: int) -> StampedeError:
    """The error for a request that names another epoch than the channel's."""
    return error_for(
        "WRONG_EPOCH",
        f"channel {name} is at epoch {actual} and the request names {stated}; resolve the channel again",
        {"channel": name, "epoch": str(actual)},
    )


def other_incarnation(name: str, stated: int, actual: int) -> StampedeError:
    """The error for a request to consume items of another incarnation than the channel's."""
    return IncarnationLost(
        f"the items are of incarnation {stated:x}, and channel {name} is incarnation {actual:x} now: they are another "
        "channel's items, or were lost with the channel's former host; consume items that were read from this channel",
        metadata={"channel": name},
    )


def deleted(name: str) -> StampedeError:
    """The error for a call or a stream whose channel was deleted meanwhile."""
    return ChannelNotFound(f"channel {name} was deleted", metadata={"channel": name})
