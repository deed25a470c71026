"""Reads the responses of a feed. The copy of a channel takes each run of a long response with one copy of its bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from stampede_rt.v1 import raw_run_pb2
from stampede_rt.wire.long_answers import split_runs
from stampede_rt_channel_host.copies.fed_items import ITEM_TAG, read_item
from stampede_rt_channel_host.core.channel import FedItem

LONG_BYTES = 2**16
"""Protobuf decodes a shorter response, because Protobuf is faster if the runs are short."""


class FedResponse(NamedTuple):
    """A response, and its encoded runs. `fields` of a long response has no runs, and `runs` are views of its bytes."""

    fields: raw_run_pb2.RawFeedResponse
    runs: Sequence[bytes | memoryview]


def read_response(raw: bytes | memoryview) -> FedResponse | FedItem:
    """Decode a response. Raises DecodeError and InvalidArgument."""
    if raw and raw[0] == ITEM_TAG:
        return read_item(raw)
    if len(raw) < LONG_BYTES:
        fields = raw_run_pb2.RawFeedResponse.FromString(raw)  # type: ignore[arg-type]
        return FedResponse(fields, [one.run for one in fields.runs])
    others, runs = split_runs(raw)
    return FedResponse(raw_run_pb2.RawFeedResponse.FromString(others), [one.encoded for one in runs])
