"""Encodes the messages of GroupService that carry runs. Does not parse the stored bytes of a whole run.

An encoded protobuf message is the sequence of its encoded fields, in any order. So this module joins fields that
protobuf has encoded, and fields that it encodes itself, to one message.
"""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt.v1 import raw_run_pb2
from stampede_rt_channel_host.channels.frames import run_bytes
from stampede_rt_channel_host.core.channel import DeliveredSlice
from stampede_rt_channel_host.core.group import FoundMatch

_LENGTH_DELIMITED = 2
_PARTS = 2  # SubscribeCutsResponse.parts
_RUNS, _LATE_RUNS = 2, 3  # CutPart.runs, CutPart.late_runs
_MATCHES = 1  # SubscribeMatchesResponse.matches
_ITEM, _MATCHED = 1, 2  # ItemMatch.item, ItemMatch.matched
_MATCHED_ITEM = 3  # MatchedItem.item


def cut_part(
    about: pb.CutPart, runs: Iterable[DeliveredSlice], late: Iterable[DeliveredSlice], *, without_payloads: bool
) -> bytes:
    """A response with one part: the fields of `about`, the runs `runs`, and the runs `late` of late items."""
    fields = [about.SerializeToString()]
    fields += [_field(_RUNS, _delivered(one, without_payloads)) for one in runs]
    fields += [_field(_LATE_RUNS, _delivered(one, without_payloads)) for one in late]
    return _field(_PARTS, b"".join(fields))


def matches(about: pb.SubscribeMatchesResponse, found: Iterable[FoundMatch], incarnations: dict[bytes, int],
            *, without_payloads: bool) -> bytes:  # fmt: skip
    """A response with the matches `found`, and the fields of `about`.

    `incarnations`: the incarnations of the members.
    """
    fields = [_field(_MATCHES, _match(one, incarnations, without_payloads)) for one in found]
    return b"".join((*fields, about.SerializeToString()))


def _match(found: FoundMatch, incarnations: dict[bytes, int], without_payloads: bool) -> bytes:
    fields = [
        pb.ItemMatch(unmatched_channel_ids=found.missing).SerializeToString(),
        _field(_ITEM, _delivered(found.item, without_payloads)),
    ]
    for channel_id, near in sorted(found.matched.items()):
        about = pb.MatchedItem(channel_id=channel_id)
        about.position.time_unix_nano, about.position.seq = near.time, near.seq
        about.position.incarnation = incarnations.get(channel_id, 0)
        item = b"" if near.item is None else _field(_MATCHED_ITEM, _delivered(near.item, without_payloads))
        fields.append(_field(_MATCHED, about.SerializeToString() + item))
    return b"".join(fields)


def _delivered(one: DeliveredSlice, without_payloads: bool) -> bytes:
    run = run_bytes(one.slice, without_payloads=without_payloads)
    return raw_run_pb2.RawDeliveredRun(run=run, next_time_unix_nano=one.next_time).SerializeToString()


def _field(number: int, body: bytes) -> bytes:
    length, encoded = len(body), bytearray((number << 3 | _LENGTH_DELIMITED,))
    while length > 0x7F:
        encoded.append(length & 0x7F | 0x80)
        length >>= 7
    encoded.append(length)
    return bytes(encoded) + body
