"""Opens the outgoing connections of services.

The connections have the limits of `Limits`. They send the secret with every call, and use certificates if the service
has any.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import grpc

from stampede_rt.cluster.cluster_ids import cluster_metadata
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import StampedeError
from stampede_rt.security.credentials import call_metadata
from stampede_rt.security.tls import TlsMaterial, TlsReader
from stampede_rt.security.tls_diagnosis import explain_refusal
from stampede_rt.transports.grpc_credentials import channel_credentials
from stampede_rt_runtime.annotated_channel import AnnotatedChannel
from stampede_rt_runtime.any_loop_channel import AnyLoopChannel
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.limits import Limits, Option
from stampede_rt_runtime.renewing import RenewingChannel
from stampede_rt_runtime.sockets.dialing import KnownEndpoints, SocketChannel
from stampede_rt_runtime.tls import ServiceTls

Dial = Callable[[str], grpc.aio.Channel]


def dial(
    target: str,
    *,
    secret: Secret | None,
    limits: Limits | None = None,
    tls: TlsReader | None = None,
    transport: Transport = Transport.GRPC,
    known: KnownEndpoints | None = None,
) -> grpc.aio.Channel:
    """A channel to `target` that sends `secret` with every call. Connects at the first call. The caller closes it.

    `transport`: the transport of streams in both directions. All other calls go over gRPC. `known`: the sockets of
    hosts, for all connections that share this object.

    With `tls` both sides prove themselves by certificates. After a renewal of the certificates, new calls use a new
    connection. The channel adds the secret itself, because gRPC's call credentials need TLS, and gRPC's interceptors
    cost a task for each call.
    """
    options = (limits or Limits()).channel_options()
    channel = _open(target, options, tls)
    if transport is not Transport.GRPC:
        channel = SocketChannel(channel, target, transport, tls, known or KnownEndpoints())
    metadata = call_metadata(secret.text if secret else None)
    return AnnotatedChannel(channel, lambda: metadata) if metadata else channel


def dial_from_any_loop(
    target: str, *, secret: Secret | None, limits: Limits | None = None, tls: TlsReader | None = None
) -> grpc.aio.Channel:
    """Like `dial`, but for unary calls that any event loop may make, one at a time.

    A blocked event loop does not delay the calls of another event loop, see `AnyLoopChannel`.
    """
    options = (limits or Limits()).channel_options()

    def connect(material: TlsMaterial | None) -> grpc.Channel:
        if material is None:
            return grpc.insecure_channel(target, options=options)
        return grpc.secure_channel(target, channel_credentials(material), options=options)

    return AnyLoopChannel(connect, call_metadata(secret.text if secret else None), tls)


def naming_cluster(dial: Dial, cluster_id: Callable[[], str]) -> Dial:
    """Return a `Dial` like `dial`, whose channels send the id of the caller's cluster with every call.

    Each call asks `cluster_id` for the id. If the id is empty, the call names no cluster.
    """

    def open_channel(target: str) -> grpc.aio.Channel:
        return AnnotatedChannel(dial(target), lambda: cluster_metadata(cluster_id()))

    return open_channel


def _open(target: str, options: list[Option], tls: TlsReader | None) -> grpc.aio.Channel:
    if tls is None:
        return grpc.aio.insecure_channel(target, options=options)

    def connect(material: TlsMaterial) -> grpc.aio.Channel:
        return grpc.aio.secure_channel(target, channel_credentials(material), options=options)

    return RenewingChannel(connect, tls)


@dataclass(frozen=True, kw_only=True, slots=True)
class Dialer:
    """Opens a service's connections, all with the same credentials. Callable like `dial`.

    `client_secret` is the secret that clients may bring to this service. The service never sends it.
    """

    secret: Secret | None
    client_secret: Secret | None = None
    tls: ServiceTls | None = None

    def __call__(self, target: str) -> grpc.aio.Channel:
        """A channel to `target`. The caller closes it."""
        return dial(target, secret=self.secret, tls=self._reader())

    def dial_streams(self, transport: Transport) -> Dial:
        """Return a `Dial` whose channels have this transport for streams in both directions."""
        return partial(dial, secret=self.secret, tls=self._reader(), transport=transport, known=KnownEndpoints())

    def dial_from_any_loop(self, target: str) -> grpc.aio.Channel:
        """See `dial_from_any_loop`."""
        return dial_from_any_loop(target, secret=self.secret, tls=self._reader())

    async def explain(self, target: str) -> StampedeError | None:
        """The reason why TLS or a certificate prevents calls of `target`; None if calls fail for another reason.

        Takes about 3 s at most, and the time to resolve the name.
        """
        return await asyncio.to_thread(explain_refusal, target, self._reader())

    def _reader(self) -> TlsReader | None:
        return self.tls.reader if self.tls else None
