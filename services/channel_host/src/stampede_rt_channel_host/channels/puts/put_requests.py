"""Reads the requests of a put stream.

Each run of a long request is a view of the request's bytes. So the host copies a run only once, when it stores the run.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from stampede_rt.v1 import raw_run_pb2
from stampede_rt.wire.varints import decode_varint
from stampede_rt_channel_host.channels.limits.memory import own_bytes
from stampede_rt_channel_host.channels.puts.long_requests import read_long
from stampede_rt_channel_host.channels.puts.whole_requests import check_without_piece
from stampede_rt_channel_host.channels.requests import parse

_TIMES_TAG = 0x0A  # field 1 of an ItemRun, packed


class Put(NamedTuple):
    """One run of a request. `wait_nanos` None: the run may wait without limit. `run` may be a view of the request.

    `ack` is a number of the enum Ack. It says for which acknowledgement the put waits.
    """

    first_number: int
    wait_nanos: int | None
    run: bytes | memoryview
    ack: int = 0

    @property
    def timed_items(self) -> int:
        """The number of times in the run, as the client encodes it; 0 for any other run."""
        try:
            return decode_varint(self.run, 1)[0] // 8 if self.run[0] == _TIMES_TAG else 0
        except IndexError:  # the host refuses such a run later
            return 0

    def kept(self) -> Put:
        """A copy whose run does not keep the whole request in memory."""
        return self._replace(run=own_bytes(self.run))


class PutRequest(NamedTuple):
    """The fields of a PutRequest. `channel_id` is empty if the request names no channel."""

    channel_id: bytes
    epoch: int
    producer_id: int
    puts: deque[Put]


def read_request(raw: bytes | bytearray | memoryview) -> PutRequest:
    """Decode a whole request. Raises InvalidArgument if `raw` is no PutRequest, or holds a piece of another request."""
    long = read_long(raw, raw_run_pb2.RawPutRequest, raw_run_pb2.RawPutRun, "PutRequest")
    if long is not None:
        puts = deque(_put_of(put, run) for put, run in long.runs)
        return PutRequest(long.head.channel_id, long.head.epoch, long.head.producer_id, puts)
    message: raw_run_pb2.RawPutRequest = parse(raw_run_pb2.RawPutRequest, bytes(raw), "PutRequest")
    check_without_piece(message)
    puts = deque(_put_of(put, put.run) for put in message.puts)
    return PutRequest(message.channel_id, message.epoch, message.producer_id, puts)


def _put_of(put: raw_run_pb2.RawPutRun, run: bytes | memoryview) -> Put:
    return Put(put.first_number, put.wait_nanos if put.HasField("wait_nanos") else None, run, put.ack)
