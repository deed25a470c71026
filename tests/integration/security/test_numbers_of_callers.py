"""A consumer place or delivery belongs to the caller that uses it. No other caller that rules restrict can change
it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt.security.credentials import call_metadata
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import channel_service_pb2_grpc as channel_grpc
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.v1 import queue_service_pb2_grpc as queue_grpc
from stampede_rt.v1.error_pb2 import ERROR_REASON_LEASE_EXPIRED
from stampede_rt.v1.queue_pb2 import Acknowledge, PendingDelivery, Settlement
from stampede_rt_local.cluster import LocalCluster
from tests.support.operator import Operator, operating
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
OWN_NUMBER = 4711


@pytest.fixture
def operator(cluster: LocalCluster) -> Iterator[Operator]:
    with operating(cluster) as made:
        yield made


class IdThief:
    """A caller that learns the ids of another caller's delivery from a listing, and names them in its own calls."""

    def __init__(self, channel: grpc.Channel, queue: st.Queue, token: str) -> None:
        self._stub: Any = queue_grpc.QueueServiceStub(channel)
        self._place: dict[str, Any] = {"queue_id": queue.info.queue_id, "epoch": queue.info.epoch}
        self._call = {"timeout": 10, "metadata": call_metadata(token)}

    def pending(self) -> PendingDelivery:
        listed = self._stub.ListPending(queue_pb.ListPendingRequest(queue_id=self._place["queue_id"]), **self._call)
        [one] = listed.deliveries
        return one

    def settle(self, taken: PendingDelivery) -> None:
        settled = [Settlement(delivery_id=taken.delivery_id, acknowledge=Acknowledge())]
        self._stub.Settle(
            queue_pb.SettleRequest(**self._place, taker_id=taken.taker_id, settlements=settled), **self._call
        )

    def take(self, taker_id: int, *settled: int) -> list[queue_pb.TakeResponse]:
        """The responses on a stream that names that taker, asks for no message, and settles these deliveries."""
        first = queue_pb.TakeRequest(
            open=queue_pb.TakeOpen(**self._place, taker_id=taker_id),
            settlements=[Settlement(delivery_id=one, acknowledge=Acknowledge()) for one in settled],
        )
        return list(self._stub.Take(iter([first]), **self._call))


@contextmanager
def robbed(operator: Operator) -> Iterator[tuple[IdThief, st.Message]]:
    """Yield a thief, and the message that another caller has taken. At the end this other caller acknowledges it."""
    operator.add("worker-*", "take", "jobs", "--kind", "queue")
    tokens = [operator.token(name) for name in ("worker-1", "worker-2")]
    with st.connect(operator.cluster.address) as own, st.connect(operator.cluster.address, secret=tokens[0]) as rt:
        own.queue("jobs").put(b"job")
        queue = rt.queue("jobs")
        message = queue.get(timeout=10)
        assert message is not None
        with grpc.insecure_channel(own.hosts()[0].endpoints[0]) as channel:
            yield IdThief(channel, queue, tokens[1]), message
        assert message.ack() is None
        assert queue.stats().held == 0


def refusal(error: pytest.ExceptionInfo[grpc.RpcError]) -> str:
    return from_rpc_error(error.value, "the host").message


def test_no_caller_settles_with_the_taker_id_of_another_caller(operator: Operator) -> None:
    with robbed(operator) as (thief, _), pytest.raises(grpc.RpcError) as caught:
        thief.settle(thief.pending())
    assert "belongs to worker-1, and worker-2 may not act for it; use a number of your own" in refusal(caught)


def test_no_caller_opens_a_stream_with_the_taker_id_of_another_caller(operator: Operator) -> None:
    with robbed(operator) as (thief, _), pytest.raises(grpc.RpcError) as caught:
        thief.take(thief.pending().taker_id)
    assert "belongs to worker-1, and worker-2 may not act for it" in refusal(caught)


def test_no_caller_settles_the_delivery_of_another_caller_on_its_own_stream(operator: Operator) -> None:
    with robbed(operator) as (thief, _):
        answer = thief.take(OWN_NUMBER, thief.pending().delivery_id)
        [result] = [one for response in answer for one in response.results]
        assert result.error.reason == ERROR_REASON_LEASE_EXPIRED
        assert thief.pending().taker_id != OWN_NUMBER


def test_no_caller_moves_the_consumer_place_of_another_caller(operator: Operator) -> None:
    operator.add("reader-*", "read,consume", "tape", "--kind", "channel")
    tokens = [operator.token(name) for name in ("reader-1", "reader-2")]
    with st.connect(operator.cluster.address) as own, st.connect(operator.cluster.address, secret=tokens[0]) as rt:
        tape = own.channel("tape", consumers=1)
        tape.put(b"first")
        tape.put(b"second")
        channel = rt.channel("tape")
        first = channel.oldest()
        assert first is not None
        assert channel.consume(first) == 1
        [place] = channel.stats().consumers
        with grpc.insecure_channel(own.hosts()[0].endpoints[0]) as port:
            stub: Any = channel_grpc.ChannelServiceStub(port)
            for fields in ({"seqs": [first.seq + 1]}, {"lease_nanos": 0}, {}):
                request = channel_pb.ConsumeRequest(
                    channel_id=channel.info.channel_id,
                    epoch=channel.info.epoch,
                    consumer_id=place.consumer_id,
                    **fields,
                )
                with pytest.raises(grpc.RpcError) as caught:
                    stub.Consume(request, timeout=10, metadata=call_metadata(tokens[1]))
                assert "belongs to reader-1, and reader-2 may not act for it" in refusal(caught)
        [after] = tape.stats().consumers
        assert (after.consumer_id, after.waiting) == (place.consumer_id, 1)
        assert after.lease_nanos > 0
