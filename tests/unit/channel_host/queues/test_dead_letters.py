"""The producer id and the numbers with which a host puts dead letters."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.v1 import channel_service_pb2, error_pb2, item_pb2, queue_pb2, queue_service_pb2
from stampede_rt_channel_host.cluster.records import recorded_queue
from stampede_rt_channel_host.queues import dead_letters
from stampede_rt_channel_host.queues.dead_letters import producer_id_of
from tests.support.waiting import until


def test_a_queue_puts_dead_letters_with_the_same_producer_id_at_every_host() -> None:
    record = recorded_queue(queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=5, epoch=1, host_id=b"a" * 16))
    elsewhere = recorded_queue(queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=5, epoch=2, host_id=b"b" * 16))
    assert producer_id_of(record) == producer_id_of(elsewhere) != 0
    assert producer_id_of(recorded_queue(queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=6))) != producer_id_of(
        record
    )


class Source:
    """A queue with one message to move."""

    def __init__(self) -> None:
        policy = SimpleNamespace(content_type="", dead_letter_queue_id=b"d" * 16)
        self.record: Any = SimpleNamespace(queue_id=b"x" * 16, incarnation=5, name="jobs", policy=policy)
        self.queue = self
        self.has_dead_letters = True
        self.replication = None

    def dead_letters(self, items_max: int) -> list[Any]:
        run = SimpleNamespace(
            body=item_pb2.ItemRun(payload_length_bytes=[1], payloads=b"x").SerializeToString(), accepted_at=1
        )
        return [SimpleNamespace(seq=7, run=run, position=0, last=None)]

    def dead_letter_moved(self, seq: int) -> None:
        self.has_dead_letters = False

    def postpone_dead_letter(self, seq: int) -> None: ...


FULL = channel_service_pb2.PutRejection(error=error_pb2.Error(reason=error_pb2.ERROR_REASON_QUEUE_FULL))
REFUSED = channel_service_pb2.PutAck(rejections=[FULL])
NOT_REPLICATED = channel_service_pb2.PutAck(
    first_seq=1, error=error_pb2.Error(reason=error_pb2.ERROR_REASON_NOT_REPLICATED)
)


@pytest.mark.parametrize("first", [REFUSED, NOT_REPLICATED], ids=["refused", "not replicated"])
async def test_a_message_without_an_ack_is_moved_again_with_the_same_number(
    monkeypatch: pytest.MonkeyPatch, first: channel_service_pb2.PutAck
) -> None:
    """With another number, the queue would store the message twice if the first put had not ended yet. In an earlier
    version, a message left its queue although the replicas of the dead-letter queue did not have it.
    """
    answers = [first, channel_service_pb2.PutAck(first_seq=1)]
    numbers: list[int] = []

    async def enqueue(connection: object, requests: list[bytes]) -> list[channel_service_pb2.PutAck]:
        numbers.extend(queue_service_pb2.EnqueueRequest.FromString(one).runs[0].first_number for one in requests)
        return [answers[len(numbers) - 1]]

    async def resolve(queue_id: bytes) -> Any:
        return SimpleNamespace(target="there", queue=SimpleNamespace(queue_id=queue_id, epoch=1))

    async def close(grace: object) -> None: ...

    monkeypatch.setattr(dead_letters, "_enqueue", enqueue)
    monkeypatch.setattr(dead_letters, "_PAUSE_SECONDS_MIN", 0.0)
    source: Any = Source()
    directory: Any = SimpleNamespace(resolve=resolve)
    dial: Any = lambda target: SimpleNamespace(close=close)  # noqa: E731
    mover = dead_letters.DeadLetterMover(directory, dial, may_move=lambda one: True, on_defect=pytest.fail)
    mover.new_dead_letters(source)
    await until(lambda: not source.has_dead_letters)
    assert numbers == [7, 7]
