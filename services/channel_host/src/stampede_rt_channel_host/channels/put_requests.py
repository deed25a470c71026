"""Reads the requests of a put stream.

Each run of a long request is a view of the request's bytes. So the host copies a run only once, when it stores the run.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from stampede_rt.v1 import raw_run_pb2
from stampede_rt.wire.runs import decode_varint
from stampede_rt_channel_host.channels.requests import parse
from stampede_rt_channel_host.channels.whole_requests import check_without_piece

SHORT_BYTES = 4096
"""Protobuf parses a request up to this length whole, which is faster. Longer requests are read field by field."""

_HEAD_TAGS = {1 << 3 | 2, 2 << 3 | 0, 3 << 3 | 1}  # channel_id, epoch and producer_id of PutRequest
_FIXED64 = 1
_PUTS_TAG = 4 << 3 | 2
_NUMBER_TAGS = {1 << 3, 2 << 3}  # first_number and wait_nanos of PutRun
_RUN_TAG = 3 << 3 | 2


class Put(NamedTuple):
    """One run of a request. `wait_nanos` None: the run may wait without limit. `run` may be a view of the request."""

    first_number: int
    wait_nanos: int | None
    run: bytes | memoryview

    def kept(self) -> Put:
        """A copy whose run does not keep the whole request in memory."""
        return self._replace(run=bytes(self.run))


class PutRequest(NamedTuple):
    """The fields of a PutRequest. `channel_id` is empty if the request names no channel."""

    channel_id: bytes
    epoch: int
    producer_id: int
    puts: deque[Put]


def read_request(raw: bytes) -> PutRequest:
    """Decode a whole request. Raises InvalidArgument if `raw` is no PutRequest, or holds a piece of another request."""
    request = _read_long(raw) if len(raw) > SHORT_BYTES else None
    if request is not None:
        return request
    message: raw_run_pb2.RawPutRequest = parse(raw_run_pb2.RawPutRequest, raw, "PutRequest")
    check_without_piece(message)
    puts = deque(_put_of(put, put.run) for put in message.puts)
    return PutRequest(message.channel_id, message.epoch, message.producer_id, puts)


def _put_of(put: raw_run_pb2.RawPutRun, run: bytes | memoryview) -> Put:
    return Put(put.first_number, put.wait_nanos if put.HasField("wait_nanos") else None, run)


def _read_long(raw: bytes) -> PutRequest | None:
    """Decode a request in the usual form: the head, then the puts, each of which ends with its run.

    Returns None for any other form, which protobuf decodes or refuses.
    """
    try:
        at = _end_of_head(raw)
        message: raw_run_pb2.RawPutRequest = parse(raw_run_pb2.RawPutRequest, raw[:at], "PutRequest")
        puts: deque[Put] = deque()
        view = memoryview(raw)
        while at < len(raw):
            if raw[at] != _PUTS_TAG:
                return None
            length, begin = decode_varint(raw, at + 1)
            at = begin + length
            run_tag, run = _run_in(raw, begin)
            if run.stop != at:
                return None
            put: raw_run_pb2.RawPutRun = parse(raw_run_pb2.RawPutRun, raw[begin:run_tag], "PutRequest")
            puts.append(_put_of(put, view[run.start : run.stop]))
    except IndexError:  # the request ends within a field
        return None
    return PutRequest(message.channel_id, message.epoch, message.producer_id, puts) if at == len(raw) else None


def _end_of_head(raw: bytes) -> int:
    """The position behind the fields of the head, which come before the puts."""
    at = 0
    while raw[at] in _HEAD_TAGS:
        if raw[at] & 7 == _FIXED64:
            at += 9
            continue
        number, value = decode_varint(raw, at + 1)
        at = value + number if raw[at] & 7 else value
    return at


def _run_in(raw: bytes, at: int) -> tuple[int, slice]:
    """The position of the run's tag in the PutRun that begins at `at`, and the slice of `raw` that is the run.

    The slice is (-1, -1) if the PutRun does not have the usual form.
    """
    while raw[at] in _NUMBER_TAGS:
        at = decode_varint(raw, at + 1)[1]
    if raw[at] != _RUN_TAG:
        return at, slice(-1, -1)
    length, begin = decode_varint(raw, at + 1)
    return at, slice(begin, begin + length)
