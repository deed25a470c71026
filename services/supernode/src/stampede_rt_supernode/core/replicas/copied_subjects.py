"""The subjects that can have copies at other hosts: channels, queues and mailboxes. Pure."""

from __future__ import annotations

from stampede_rt_supernode.core.lookups import channel_by_id, queue_by_id
from stampede_rt_supernode.core.records import ChannelRecord, QueueRecord
from stampede_rt_supernode.core.tables import Tables

Copied = ChannelRecord | QueueRecord


def copied_by_id(tables: Tables, subject_id: bytes, *, is_of_queue: bool) -> Copied:
    """The subject of that id. Raises InvalidArgument, ChannelNotFound or QueueNotFound."""
    return queue_by_id(tables, subject_id) if is_of_queue else channel_by_id(tables, subject_id)


def known_copied_by_id(tables: Tables, subject_id: bytes) -> Copied:
    """The subject of an id that the table of copies has. Ids are random, so a channel and a queue never share one."""
    channel = tables.channels.get(subject_id)
    return tables.queues.by_id[subject_id] if channel is None else channel


def id_of(subject: Copied) -> bytes:
    """The id of the subject."""
    return subject.queue_id if isinstance(subject, QueueRecord) else subject.channel_id


def shown(subject: Copied) -> str:
    """The subject as error texts name it."""
    if isinstance(subject, QueueRecord):
        return f"queue {subject.name or subject.queue_id.hex()}"
    return f"channel {subject.name}"


def about(subject: Copied) -> dict[str, str]:
    """The metadata of errors about the subject."""
    if isinstance(subject, QueueRecord):
        return {"queue": subject.name or subject.queue_id.hex()}
    return {"channel": subject.name}
