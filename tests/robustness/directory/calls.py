"""The requests for calls about a name, and the facts in the answers, for channels and queues alike."""

from __future__ import annotations

import random
from typing import Any

from stampede_rt.v1 import channel_pb2, queue_pb2
from stampede_rt.v1 import directory_service_pb2 as channels_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queues_pb
from tests.robustness.histories.channel_model import Delete, Open, Refusal, Resolve, SeenChannel, Update
from tests.robustness.real_cluster.callers import FINAL_REASONS, seen_in

Call = Open | Resolve | Update | Delete
QUEUES = "queue/"
FINAL = FINAL_REASONS | {"QUEUE_NOT_FOUND"}


def request_of(name: str, call: Call, random_source: random.Random) -> tuple[str, Any]:
    """The RPC and its request. Names below QUEUES are names of queues."""
    return (
        _queue_request(name, call, random_source)
        if name.startswith(QUEUES)
        else _channel_request(name, call, random_source)
    )


def _channel_request(name: str, call: Call, random_source: random.Random) -> tuple[str, Any]:
    identity = random_source.randbytes(16)
    match call:
        case Open():
            return "OpenChannel", channels_pb.OpenChannelRequest(request_id=identity, name=name, create=True)
        case Resolve():
            return "ResolveChannel", channels_pb.ResolveChannelRequest(name=name)
        case Update(channel_id=channel_id, epoch=epoch, value=value):
            spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=value))
            return "UpdateChannel", channels_pb.UpdateChannelRequest(
                request_id=identity, channel_id=channel_id, epoch=epoch, spec=spec
            )
        case Delete(channel_id=channel_id):
            return "DeleteChannel", channels_pb.DeleteChannelRequest(request_id=identity, channel_id=channel_id)


def _queue_request(name: str, call: Call, random_source: random.Random) -> tuple[str, Any]:
    identity = random_source.randbytes(16)
    match call:
        case Open():
            return "OpenQueue", queues_pb.OpenQueueRequest(request_id=identity, name=name, create=True)
        case Resolve():
            return "ResolveQueue", queues_pb.ResolveQueueRequest(name=name)
        case Update(channel_id=queue_id, epoch=epoch, value=value):
            return "UpdateQueue", queues_pb.UpdateQueueRequest(
                request_id=identity, queue_id=queue_id, epoch=epoch, spec=queue_pb2.QueueSpec(max_items=value)
            )
        case Delete(channel_id=queue_id):
            return "DeleteQueue", queues_pb.DeleteQueueRequest(request_id=identity, queue_id=queue_id)


def shown(name: str, answer: Any) -> SeenChannel:
    """The facts in an answer with a record."""
    created = getattr(answer, "created", False)
    if not name.startswith(QUEUES):
        return seen_in(answer.channel, created=created)
    queue = answer.queue
    return SeenChannel(queue.queue_id, queue.epoch, queue.spec.max_items, queue.spec_version, created)


def refusal_of(reason: str) -> Refusal:
    """The refusal in the terms of channels: queues have the same model."""
    return Refusal("CHANNEL_NOT_FOUND" if reason == "QUEUE_NOT_FOUND" else reason)


def host_id_of(name: str, answer: Any) -> bytes:
    """The owner that an answer names."""
    record = answer.queue if name.startswith(QUEUES) else answer.channel
    return bytes(record.host_id)
