"""Encodes TakeResponse by hand. The host copies a stored run once, into the message, and does not parse a whole run."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.v1 import queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt.wire.run_slices import RunSlicer
from stampede_rt.wire.varints import encode_varint
from stampede_rt_channel_host.core.queue import Batch, LeasedSlice

_LENGTH_DELIMITED = 2
_RUNS = bytes((1 << 3 | _LENGTH_DELIMITED,))  # TakeResponse.runs
_RUN = bytes((1 << 3 | _LENGTH_DELIMITED,))  # LeasedRun.run


def take_response(
    batch: Batch | None,
    results: Sequence[queue_pb2.SettlementResult],
    now: int,
    *,
    incarnation: int = 0,
    drained: bool = False,
) -> bytes:
    """An encoded TakeResponse. `now` serves to compute the rest of each lease. `drained`: the host answers `drain`.

    The fields need no order, because protobuf accepts any order on the wire.
    """
    parts = [pb.TakeResponse(results=results, incarnation=incarnation, drained=drained).SerializeToString()]
    if batch is not None:
        for one in batch.slices:
            _add_run(parts, one, max(0, batch.expires - now))
    return b"".join(parts)


def _add_run(parts: list[bytes], one: LeasedSlice, lease_nanos: int) -> None:
    body = _run_bytes(one)
    about = queue_pb2.LeasedRun(
        delivery_ids=one.delivery_ids,
        deliveries=one.deliveries if max(one.deliveries) > 1 else (),
        lease_nanos=lease_nanos,
    ).SerializeToString()
    length = encode_varint(len(body))
    whole = encode_varint(len(_RUN) + len(length) + len(body) + len(about))
    parts += (_RUNS, whole, _RUN, length, body, about)


def _run_bytes(one: LeasedSlice) -> bytes:
    """The encoded run of a slice. A slice that covers its whole run gives the stored bytes."""
    run = one.run
    if one.hi - one.lo == len(run.lengths):
        return run.body
    if run.slicer is None:
        run.slicer = RunSlicer(run.body)
    return run.slicer.cut(one.lo, one.hi, without_payloads=False)
