"""Fields of protobuf messages in fixed places."""

from __future__ import annotations

import struct

import pytest

from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.fixed_fields import FixedFields, LongField

NUMBERS = FixedFields("QQQQqIB")
OWNER, RUN = LongField(8), LongField(9)


def test_protobuf_reads_fixed_fields() -> None:
    encoded = NUMBERS.encode(1, 0, 2**64 - 1, 4, -5, 6, True)
    message = pb.FedQueuePut.FromString(encoded)
    found = message.step, message.seq, message.producer_id, message.first_number
    assert found == (1, 0, 2**64 - 1, 4)
    assert (message.stamped_unix_nano, message.payload_length_bytes, message.is_stamped) == (-5, 6, True)
    assert NUMBERS.read(b"?" + encoded, 1) == NUMBERS.read_whole(encoded) == (1, 0, 2**64 - 1, 4, -5, 6, 1)
    assert len(encoded) == NUMBERS.size_bytes


def test_other_fields_are_not_read() -> None:
    encoded = NUMBERS.encode(1, 2, 3, 4, 5, 6, 7)
    assert FixedFields("QQQQqIB", first=2).read(encoded) is None
    assert FixedFields("Q").read_whole(encoded) is None
    assert FixedFields("Q").read_whole(encoded[:9]) == (1,)
    with pytest.raises(struct.error):
        NUMBERS.read(encoded[:-1])


@pytest.mark.parametrize("length", [0, 1, 127, 128, 70_000])
def test_protobuf_reads_a_long_field(length: int) -> None:
    run = bytes(length)
    encoded = OWNER.encode(b"cl", b"ient") + RUN.head(length) + run
    assert pb.FedQueuePut.FromString(encoded) == pb.FedQueuePut(owner="client", run=run)
    assert OWNER.find(encoded) == (2, 8)
    begin, end = RUN.find(memoryview(encoded), 8) or (0, 0)
    assert (encoded[begin:end], end) == (run, len(encoded))
    assert RUN.find(encoded) is None
    with pytest.raises(IndexError):
        RUN.find(encoded[:9], 8)
