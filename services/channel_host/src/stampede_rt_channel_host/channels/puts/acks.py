"""The acks that tell a producer the outcomes of its runs. Channels and queues use the same acks."""

from __future__ import annotations

from stampede_rt.errors import StampedeError
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.core.run_outcome import RunOutcome


def ack_of(first_number: int, judged: RunOutcome, incarnation: int) -> pb.PutAck:
    """The ack of a run of which the host has judged every item: accepted or refused it."""
    ack = pb.PutAck(
        first_number=first_number,
        items=judged.items,
        first_seq=judged.first_seq,
        stamped_unix_nano=judged.stamped_time,
        host_time_unix_nano=judged.time,
        incarnation=incarnation,
    )
    if judged.refusals:
        ack.rejections.extend(
            pb.PutRejection(index=one.position, error=to_error_message(one.error)) for one in judged.refusals
        )
    if len(judged.parts) > 1:
        ack.later_parts.extend(
            pb.PutPart(index=one.position, first_seq=one.first_seq, stamped_unix_nano=one.stamped_time)
            for one in judged.parts[1:]
        )
    return ack


def refused(first_number: int, items: int, error: StampedeError, now: int, incarnation: int = 0) -> pb.PutAck:
    """The ack of a run that the host refused as a whole."""
    return pb.PutAck(
        first_number=first_number,
        items=items,
        error=to_error_message(error),
        host_time_unix_nano=now,
        incarnation=incarnation,
    )
