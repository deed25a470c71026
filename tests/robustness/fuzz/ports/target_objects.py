"""The channels, queues and group that hostile callers find in a cluster, and the values that they know of them.

Whatever a caller deletes is made again within seconds.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import stampede_rt as st
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import group_directory_service_pb2 as group_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queue_pb
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from stampede_rt.v1.group_directory_service_pb2_grpc import GroupDirectoryServiceStub
from stampede_rt.v1.queue_directory_service_pb2_grpc import QueueDirectoryServiceStub
from stampede_rt.version import PROTOCOL_VERSION
from stampede_rt_runtime.identity import Role
from tests.robustness.fuzz.messages import KnownValues
from tests.robustness.fuzz.ports.cluster import FuzzedCluster

PERIOD_SECONDS, CALL_SECONDS = 1.0, 10.0
MS, S = 10**6, 10**9
NAMES = ("a", "b", "c", "d", "cam/1", "cam/2", "q", "r", "g", "h1", "hostile")
MEMBERS = ("s1", "s9")
TOLD: dict[str, Sequence[Any]] = {
    **dict.fromkeys(("name", "name_glob", "taker_name", "host_name", "mailbox_host_name"), NAMES),
    **dict.fromkeys(("supernode_id", "member_id", "peer_member_id"), MEMBERS),
    **dict.fromkeys(
        ("producer_id", "consumer_id", "taker_id", "call_id", "first_number", "boot_incarnation"), (1, 2, 3)
    ),
    **dict.fromkeys(("wait_nanos", "max_wait_nanos", "delay_nanos"), (0, MS, -1)),
    **dict.fromkeys(("lease_nanos", "valid_nanos"), (S, 10 * S)),
    **dict.fromkeys(("tolerance_nanos", "lateness_nanos"), (0, MS)),
    **dict.fromkeys(("credit", "credit_bytes", "limit", "page_size"), (1, 100, 1000)),
    **dict.fromkeys(("kind", "mode", "match"), (1, 2)),
    **dict.fromkeys(("request_id", "peer_id", "host_id"), tuple(bytes([one]) * 16 for one in range(1, 20))),
    "target": ("localhost:1", "127.0.0.1:2"),
    "proof": (b"p" * 32, b""),
    "epoch": (1, 0),
    "protocol_version": (PROTOCOL_VERSION,),
}
# The things of the cluster, with their policies.
CHANNELS: dict[str, dict[str, Any]] = {
    "a": {"max_items": 50},
    "b": {"max_items": 20, "consumers": 1, "on_full": "block"},
    "c": {"max_age": "5s", "overlap": "1s"},
    "d": {"max_items": 5, "archive": "10s", "archive_bytes": "1MiB"},
}
QUEUES: dict[str, dict[str, Any]] = {"q": {"max_items": 50, "lease": "1s"}, "r": {"max_items": 20, "copies": 2}}
LISTED: tuple[tuple[Any, str, Any], ...] = (
    (DirectoryServiceStub, "ListChannels", directory_pb.ListChannelsRequest(name_glob="?")),
    (DirectoryServiceStub, "ListSupernodes", directory_pb.ListSupernodesRequest()),
    (QueueDirectoryServiceStub, "ListQueues", queue_pb.ListQueuesRequest()),
    (GroupDirectoryServiceStub, "ListGroups", group_pb.ListGroupsRequest()),
)


async def first_known(cluster: FuzzedCluster, good: str) -> KnownValues:
    """The values that callers know at first, by field, without the good client's channel and the host's identity."""
    known = KnownValues()
    answer = await _operator_call(
        cluster, DirectoryServiceStub, "ResolveChannel", directory_pb.ResolveChannelRequest(name=good)
    )
    known.spare(good, answer.channel.channel_id, answer.host.host_id, answer.host.boot_incarnation)
    for name, values in TOLD.items():
        known.add(name, *values)
    return known


async def keep_targets(rt: Any, cluster: FuzzedCluster, known: KnownValues) -> None:
    """Make the missing things again and learn their ids, each second until cancelled. Ignores failures."""
    while True:
        with suppress(st.StampedeError, TimeoutError):
            async with asyncio.timeout(CALL_SECONDS):
                await _make(rt)
                for service, method, request in LISTED:
                    known.learn(await _operator_call(cluster, service, method, request))
        await asyncio.sleep(PERIOD_SECONDS)


async def _make(rt: Any) -> None:
    channels = [await rt.channel(name, host="h1", **policy) for name, policy in CHANNELS.items()]
    for channel in channels:
        await _put(channel)
    for name, policy in QUEUES.items():
        await _put(await rt.queue(name, host="h1", **policy))
    await rt.group("g", channels)


async def _put(place: Any) -> None:
    with suppress(st.StampedeError):  # the queue may be full
        await place.put(b"first", timeout=0)


async def _operator_call(cluster: FuzzedCluster, service: Any, method: str, request: Any) -> Any:
    async with cluster.channel(cluster.processes.supernodes[0].address, Role.OPERATOR) as channel:
        return await getattr(service(channel), method)(request, metadata=cluster.metadata)
