"""The errors with which a host refuses requests for queues that it does not serve. Pure."""

from __future__ import annotations

from stampede_rt.errors import QueueNotFound, StampedeError, Unavailable, error_for
from stampede_rt_channel_host.core.records import RecordedQueue

SHUTTING_DOWN = error_for(
    "SHUTTING_DOWN", "this host is shutting down; resolve the queue again for its new host, or wait for this one"
)


def display_name(record: RecordedQueue) -> str:
    """The name of a queue for people. A mailbox has no name, so its id stands for it."""
    return record.name or record.queue_id.hex()


def fenced(host: str) -> StampedeError:
    """The error of a host that did not renew its lease in time. Another host may own the queues by now."""
    return error_for(
        "NOT_HERE",
        f"host {host} could not renew its lease in time and serves nothing until the lease is renewed; resolve the "
        "queue again, or wait",
        {"host": host},
    )


def not_here(host: str, queue_id: bytes) -> StampedeError:
    """The error for a queue that this host does not know, or that another host owns now."""
    text = f"queue {queue_id.hex()} is not at host {host}; resolve it at the directory, and call its host"
    return error_for("NOT_HERE", text, {"queue_id": queue_id.hex(), "host": host})


def moved(record: RecordedQueue) -> StampedeError:
    """The error for a queue for which the directory names another owner."""
    host_id = record.host_id.hex()
    text = f"queue {display_name(record)} is at host {host_id} now; resolve it again"
    return error_for("MOVED", text, {"queue": display_name(record), "host_id": host_id})


def moved_to(record: RecordedQueue, host_id: bytes) -> StampedeError:
    """The error for a queue that this host has just handed over."""
    name = display_name(record)
    text = f"queue {name} has moved to host {host_id.hex()}; resolve it again"
    return error_for("MOVED", text, {"queue": name, "host_id": host_id.hex()})


def is_moving(record: RecordedQueue) -> StampedeError:
    """The error for calls and streams of a queue that moves to another host."""
    name = display_name(record)
    return error_for("NOT_HERE", f"queue {name} is moving to another host; resolve it again", {"queue": name})


def has_lost_steps(record: RecordedQueue) -> StampedeError:
    """The error for a move whose copy lacks steps of the queue."""
    return Unavailable(
        f"queue {display_name(record)} changes faster than the copy of its move, or has begun or stopped to have "
        "replicas; move it again"
    )


def wrong_epoch(record: RecordedQueue, stated: int) -> StampedeError:
    """The error for a request that names another epoch than the queue's."""
    name, epoch = display_name(record), record.epoch
    text = f"queue {name} is at epoch {epoch} and the request names {stated}; resolve the queue again"
    return error_for("WRONG_EPOCH", text, {"queue": name, "epoch": str(epoch)})


def deleted(record: RecordedQueue) -> StampedeError:
    """The error for a call or a stream whose queue was deleted meanwhile."""
    return QueueNotFound(f"queue {display_name(record)} was deleted", metadata={"queue": display_name(record)})
