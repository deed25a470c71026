"""The cluster that an attack uses, and the common parts of attackers."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub

GOOD_CHANNEL = "good"
TRANSPORT = "socket"  # for good clients and attackers: reads of shared memory would not reach the host
NAME_VARIABLE = "STAMPEDE_ATTACK_NAME"  # the attacker's things have this name as their prefix
OPTIONS = [
    ("grpc.max_receive_message_length", -1),
    ("grpc.use_local_subchannel_pool", 1),  # each channel has a connection of its own
    ("grpc.http2.bdp_probe", 0),
]

CHANNELS: list[grpc.aio.Channel] = []  # channels without a reference would be closed


@dataclass(frozen=True, kw_only=True)
class AttackedCluster:
    """The addresses of a cluster with one host and one supernode, and the attacker's token or secret.

    `data_port`: the address of the host's TCP port for streams. `flooded`: a bare server that gets the calls of an
    attack instead of the host, see `bare.py`; empty: the host. `member_secret`: the secret of the cluster; empty: its
    services ask no caller for a secret.
    """

    frontend: str
    supernode: str
    host: str
    secret: str
    data_port: str = ""
    flooded: str = ""
    member_secret: str = ""

    @property
    def data_target(self) -> str:
        """The host's TCP port, as `raw_stream` takes it."""
        return f"tcp:{self.data_port}"

    @property
    def thing(self) -> str:
        """The name that the attacker gives to its things."""
        return os.environ.get(NAME_VARIABLE, "attack")

    @property
    def member_metadata(self) -> tuple[tuple[str, str], ...]:
        """The metadata with the credential of a service of the cluster."""
        return (("authorization", f"Bearer {self.member_secret}"),) if self.member_secret else ()

    @property
    def target(self) -> str:
        """The host, or the bare server that the attack floods instead of it."""
        return self.flooded or self.host

    @property
    def metadata(self) -> tuple[tuple[str, str], ...]:
        """The metadata with the caller's credential."""
        return (("authorization", f"Bearer {self.secret}"),)

    def connect(self) -> Any:
        """Connect as a usual client."""
        return st.aio.connect(self.frontend, secret=self.secret, transport=TRANSPORT)

    def channel(self, target: str) -> grpc.aio.Channel:
        """A new connection to a port of the cluster."""
        made = grpc.aio.insecure_channel(target, options=OPTIONS)
        CHANNELS.append(made)
        return made

    async def bound(self, name: str) -> dict[str, Any]:
        """The fields that name a channel in requests to its host. Creates the channel."""
        async with self.channel(self.supernode) as supernode, self.channel(self.host) as host:
            resolve: Any = DirectoryServiceStub(supernode).ResolveChannel
            record = (await resolve(pb.ResolveChannelRequest(name=name), metadata=self.metadata)).channel
            known = {"channel_id": record.channel_id, "epoch": record.epoch}
            bind: Any = GatekeeperServiceStub(host).BindChannel
            await bind(gate_pb.BindChannelRequest(**known), metadata=self.metadata)
        return known

    def to_line(self) -> str:
        """The line for the attacker's standard input. It has the secret, which must not be an argument of a process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_line(cls, line: str) -> AttackedCluster:
        return cls(**json.loads(line))


# An attack runs until it is cancelled. It calls the given function once it is under way.
Attack = Callable[[AttackedCluster, Callable[[], None]], Awaitable[None]]


class Uploads:
    """Sends large encoded requests in pieces. Each request has its own stream and connection."""

    def __init__(self, attacked: AttackedCluster, method: str) -> None:
        self._attacked, self._method = attacked, method
        self._calls: list[Any] = []  # a call without a reference would be cancelled
        self._sent = 0
        self._tasks: list[asyncio.Task[None]] = []

    def begin(self, messages: Sequence[bytes]) -> None:
        """Send these messages on a new connection, as fast as the host takes them."""
        self._tasks.append(asyncio.create_task(self._send(messages)))

    async def _send(self, messages: Sequence[bytes]) -> None:
        call: Any = self._attacked.channel(self._attacked.host).stream_stream(self._method)(
            metadata=self._attacked.metadata
        )
        self._calls.append(call)
        for message in messages:
            await call.write(message)
            self._sent += 1

    async def until_stuck(self) -> None:
        """Return when the host has taken nothing more for a second."""
        before = -1
        while before < self._sent or not self._sent:
            before = self._sent
            await asyncio.sleep(1.0)


async def for_ever() -> None:
    """Wait until the attack is over."""
    await asyncio.Event().wait()


async def all_of(*work: Awaitable[Any]) -> None:
    """Run all of them together. Ignores refusals, as an attacker does."""
    await asyncio.gather(*work, return_exceptions=True)
