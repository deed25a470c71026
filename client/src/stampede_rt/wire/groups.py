"""Converts groups, members and cuts from protobuf, and group specs to it (`group.proto`, `group_service.proto`)."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.v1 import group_pb2, group_service_pb2
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import GroupInfo, MemberStatus
from stampede_rt.values.model import Item
from stampede_rt.values.timeline import ResolvedInterval
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.reads import reason_from_message

_BOUNDS = {"start": group_pb2.GROUP_BOUND_START, "end": group_pb2.GROUP_BOUND_END}
MAX_LEAD_DEFAULT_NANOS = 5_000_000_000


def group_spec(
    channel_ids: Sequence[bytes],
    reference_id: bytes | None,
    bound: str,
    idle_after_nanos: int | None,
    max_lead_nanos: int,
) -> group_pb2.GroupSpec:
    """Return the message for the members and settings that the creator of a group states."""
    return group_pb2.GroupSpec(
        channel_ids=channel_ids,
        reference=group_pb2.GROUP_REFERENCE_CHANNEL if reference_id else group_pb2.GROUP_REFERENCE_OLDEST,
        reference_channel_id=reference_id or b"",
        bound=_BOUNDS[bound],
        idle_after_nanos=idle_after_nanos,
        max_lead_nanos=max_lead_nanos,
    )


def group_info(record: group_pb2.GroupRecord) -> GroupInfo:
    """Return a group, as callers see it."""
    spec = record.spec
    by_channel = spec.reference == group_pb2.GROUP_REFERENCE_CHANNEL
    return GroupInfo(
        group_id=record.group_id,
        name=record.name,
        channel_ids=tuple(spec.channel_ids),
        reference_id=spec.reference_channel_id if by_channel else None,
        bound="end" if spec.bound == group_pb2.GROUP_BOUND_END else "start",
        idle_after_nanos=spec.idle_after_nanos if spec.HasField("idle_after_nanos") else None,
        max_lead_nanos=spec.max_lead_nanos if spec.HasField("max_lead_nanos") else MAX_LEAD_DEFAULT_NANOS,
        incarnation=record.incarnation,
        spec_version=record.spec_version,
        created_by=record.created_by,
    )


def member_status(message: group_pb2.GroupMemberStatus) -> MemberStatus:
    """Return one member's status."""
    times = message.times
    return MemberStatus(
        newest=times.newest_unix_nano if times.HasField("newest_unix_nano") else None,
        advance=times.advance_unix_nano if times.HasField("advance_unix_nano") else None,
        cut=message.cut_unix_nano if message.HasField("cut_unix_nano") else None,
        lead_nanos=message.lead_nanos if message.HasField("lead_nanos") else None,
        hidden=message.hidden_items if message.HasField("hidden_items") else None,
        idle=message.idle,
        window_too_short=message.window_too_short,
        heard_ago_nanos=message.heard_ago_nanos,
    )


def cut_items(
    parts: Sequence[group_service_pb2.CutPart], decoder: ItemDecoder, since: int, cut: int
) -> tuple[Items, Sequence[Item]]:
    """Return one channel's items of one cut event: the items from the cut `since` to `cut`, and the late items.

    `parts`: the channel's parts of the event.
    """
    losses = [part.loss for part in parts if part.HasField("loss")]
    items = Items(
        decoder.decode([run for part in parts for run in part.runs]),
        interval=ResolvedInterval(since, cut, False, True),
        complete=True,
        truncated=bool(losses),
        more=False,
        reason=reason_from_message(losses[-1].reason, losses[-1].detail) if losses else None,
        incarnation=parts[-1].cursor.incarnation if parts else 0,
        cut=cut,
    )
    return items, decoder.decode([run for part in parts for run in part.late_runs])
