"""The RPCs of the contract, by the port that serves them."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass

from google.protobuf.descriptor import Descriptor
from google.protobuf.message_factory import GetMessageClass

from stampede_rt import v1

DATA_PORT = "data"
"""The TCP port of a host for streams. The port "host" has its gRPC port and its Unix socket."""
PORTS = ("host", DATA_PORT, "supernode", "frontend")
_HOST = ("ChannelService", "GatekeeperService", "GroupService", "QueueService", "MigrationService", "ReplicaService")
_FRONTEND = ("FrontendService",)
_SELDOM = ("/Delete", "/Drop", "/Deregister", "/Remove", "/AddAccessRule", "Migration", ".ReplicaService")


@dataclass(frozen=True, kw_only=True)
class Method:
    """One RPC."""

    path: str
    request: Descriptor
    response: type
    takes_stream: bool
    answers_stream: bool

    @property
    def weight(self) -> int:
        """The weight of the method in the random choice. It is low for methods of _SELDOM, such as deletions."""
        return 1 if any(word in self.path for word in _SELDOM) else 8

    @property
    def may_stay_open(self) -> bool:
        return self.takes_stream or self.answers_stream


def methods_of(port: str) -> list[Method]:
    """The methods that the service behind this port has."""
    return [
        Method(
            path=f"/{service.full_name}/{method.name}",
            request=method.input_type,
            response=GetMessageClass(method.output_type),
            takes_stream=method.client_streaming,
            answers_stream=method.server_streaming,
        )
        for name in sorted(module.name for module in pkgutil.iter_modules(v1.__path__))
        if name.endswith("_service_pb2")
        for service in importlib.import_module(f"{v1.__name__}.{name}").DESCRIPTOR.services_by_name.values()
        if _port_of(service.name) == ("host" if port == DATA_PORT else port)
        for method in service.methods
        if port != DATA_PORT or (method.client_streaming and method.server_streaming)
    ]


def _port_of(service: str) -> str:
    if service in _HOST:
        return "host"
    return "frontend" if service in _FRONTEND else "supernode"
