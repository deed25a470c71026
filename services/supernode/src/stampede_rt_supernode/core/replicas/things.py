"""The things that can have copies at other hosts: channels, queues and mailboxes. Pure."""

from __future__ import annotations

from stampede_rt_supernode.core.lookups import channel_by_id, queue_by_id
from stampede_rt_supernode.core.records import ChannelRecord, QueueRecord
from stampede_rt_supernode.core.tables import Tables

Copied = ChannelRecord | QueueRecord


def copied_by_id(tables: Tables, thing_id: bytes, *, is_of_queue: bool) -> Copied:
    """The thing of that id. Raises InvalidArgument, ChannelNotFound or QueueNotFound."""
    return queue_by_id(tables, thing_id) if is_of_queue else channel_by_id(tables, thing_id)


def copied_with_id(tables: Tables, thing_id: bytes) -> Copied:
    """The thing of an id that the table of copies has. Ids are random, so a channel and a queue never share one."""
    channel = tables.channels.get(thing_id)
    return tables.queues.by_id[thing_id] if channel is None else channel


def id_of(thing: Copied) -> bytes:
    """The id of the thing."""
    return thing.queue_id if isinstance(thing, QueueRecord) else thing.channel_id


def shown(thing: Copied) -> str:
    """The thing as error texts name it."""
    if isinstance(thing, QueueRecord):
        return f"queue {thing.name or thing.queue_id.hex()}"
    return f"channel {thing.name}"


def about(thing: Copied) -> dict[str, str]:
    """The metadata of errors about the thing."""
    if isinstance(thing, QueueRecord):
        return {"queue": thing.name or thing.queue_id.hex()}
    return {"channel": thing.name}
