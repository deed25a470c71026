"""Messages of queues that the host encodes by hand."""

from __future__ import annotations

from stampede_rt.v1 import item_pb2, queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.core.queue import Batch, LeasedSlice, QueuedRun
from stampede_rt_channel_host.queues.frames import take_response


def stored(first_seq: int, *payloads: bytes) -> QueuedRun:
    body = item_pb2.ItemRun(
        time_unix_nano=[1] * len(payloads),
        payload_length_bytes=[len(payload) for payload in payloads],
        payloads=b"".join(payloads),
        first_seq=first_seq,
    )
    return QueuedRun(first_seq, tuple(map(len, payloads)), 0, body.SerializeToString())


def test_a_framed_response_equals_the_bytes_of_the_generated_message() -> None:
    whole, cut = stored(1, b"a", b"bb"), stored(3, b"c" * 200, b"d", b"e")
    batch = Batch([LeasedSlice(whole, 0, 2, [7, 8], [1, 1]), LeasedSlice(cut, 1, 3, [9, 10], [1, 4])], 500)
    results = [queue_pb2.SettlementResult(delivery_id=5)]
    found = pb.TakeResponse.FromString(take_response(batch, results, 100, incarnation=3, drained=True))
    first, second = found.runs
    assert (list(first.delivery_ids), list(first.deliveries), first.lease_nanos) == ([7, 8], [], 400)
    assert first.run.SerializeToString() == whole.body
    assert (list(second.delivery_ids), list(second.deliveries)) == ([9, 10], [1, 4])
    assert (second.run.payloads, second.run.first_seq) == (b"de", 4)
    assert (found.incarnation, found.drained, list(found.results)) == (3, True, results)
