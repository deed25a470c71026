"""The summary of a get's answer: all facts in the answer except the items."""

from __future__ import annotations

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.reads import reason_to_message, resolved_to_message
from stampede_rt_channel_host.channels.gets.outbox import COUNTED_BYTES_MAX
from stampede_rt_channel_host.channels.past_reads import PastSummary
from stampede_rt_channel_host.core.channel import (
    ITEM_OVERHEAD_BYTES,
    ReadAnswer,
)


def summary_of(answer: ReadAnswer, now: int, cut: int | None) -> pb.GetSummary:
    """The facts about an answer, without its items.

    `cut`: the cut of the group; None for a read without a group, or if the group has no cut yet.
    """
    return pb.GetSummary(
        interval=resolved_to_message(answer.interval) if answer.interval else None,
        complete=answer.complete,
        truncated=answer.truncated,
        more=answer.more,
        reason=reason_to_message(answer.reason),
        detail=answer.reason.detail if answer.reason else "",
        incarnation=answer.incarnation,
        cut_unix_nano=cut,
        host_time_unix_nano=now,
        lost_before_unix_nano=answer.reason.before if answer.reason else None,
    )


def past_to_message(past: PastSummary) -> pb.PastSummary:
    """The facts about the channel at the instant as of which a get was answered."""
    message = pb.PastSummary(advance_unix_nano=past.advance, next_change_unix_nano=past.next_change)
    if past.next_items is not None:
        message.next_seq = past.next_items.first_seq
        message.next_start_unix_nano, message.next_end_unix_nano = past.next_items.start, past.next_items.end
    return message


def kept_bytes_of(answer: ReadAnswer) -> int:
    """The bytes that the stored runs of an answer occupy in memory, at most COUNTED_BYTES_MAX."""
    kept_bytes = 0
    for part in answer.slices:
        kept_bytes += len(part.run.body) + ITEM_OVERHEAD_BYTES
        if kept_bytes > COUNTED_BYTES_MAX:
            return COUNTED_BYTES_MAX
    return kept_bytes
