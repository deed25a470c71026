"""The stubs of the RPCs that clients use, for each kind of server."""

from __future__ import annotations

from typing import Any

from stampede_rt.transports.grpc_options import SUBSCRIBE_METHOD
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from stampede_rt.v1.frontend_service_pb2_grpc import FrontendServiceStub
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.v1.group_directory_service_pb2_grpc import GroupDirectoryServiceStub
from stampede_rt.v1.group_service_pb2_grpc import GroupServiceStub
from stampede_rt.v1.migration_service_pb2_grpc import MigrationServiceStub
from stampede_rt.v1.peer_service_pb2_grpc import PeerServiceStub
from stampede_rt.v1.queue_directory_service_pb2_grpc import QueueDirectoryServiceStub
from stampede_rt.v1.queue_service_pb2_grpc import QueueServiceStub
from stampede_rt.v1.replica_directory_service_pb2_grpc import ReplicaDirectoryServiceStub
from stampede_rt.wire.long_answers import read_answer

_OF_SUPERNODES = (
    DirectoryServiceStub,
    GroupDirectoryServiceStub,
    QueueDirectoryServiceStub,
    PeerServiceStub,
    ReplicaDirectoryServiceStub,
)


class DirectoryStubs:
    """The RPCs of all services that supernodes serve to callers. Each is an attribute with the name of the RPC."""

    def __init__(self, channel: Any) -> None:
        self._methods: dict[str, Any] = {}
        for stub in _OF_SUPERNODES:
            self._methods |= vars(stub(channel))

    def __getattr__(self, method: str) -> Any:
        try:
            return self._methods[method]
        except KeyError:
            raise AttributeError(f"supernodes serve no RPC {method!r}") from None


class Stubs:
    """All stubs of one connection. Each server serves some of them."""

    def __init__(self, channel: Any) -> None:
        self.frontend = FrontendServiceStub(channel)
        self.directory = DirectoryStubs(channel)
        self.gatekeeper = GatekeeperServiceStub(channel)
        self.channels = ChannelServiceStub(channel)
        self.groups = GroupServiceStub(channel)
        self.queues = QueueServiceStub(channel)
        self.moves = MigrationServiceStub(channel)
        encode = channel_pb.SubscribeRequest.SerializeToString
        self.subscribe = channel.stream_stream(SUBSCRIBE_METHOD, encode, read_answer)
        """ChannelService.Subscribe. Its responses are SubscribeAnswers."""
