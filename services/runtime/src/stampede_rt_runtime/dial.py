"""Opens the outgoing connections of services.

The connections have the limits of `Limits`. They send the secret with every call, and use certificates if the service
has any.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import grpc

from stampede_rt.cluster.cluster_ids import cluster_metadata
from stampede_rt.errors import StampedeError
from stampede_rt.security.credentials import call_metadata
from stampede_rt.security.tls import TlsMaterial, TlsReader
from stampede_rt.security.tls_diagnosis import explain_refusal
from stampede_rt.transports.grpc_credentials import channel_credentials
from stampede_rt_runtime.any_loop_channel import AnyLoopChannel
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.limits import Limits, Option
from stampede_rt_runtime.renewing import RenewingChannel
from stampede_rt_runtime.tls import ServiceTls

Dial = Callable[[str], grpc.aio.Channel]
Metadata = tuple[tuple[str, str], ...]


def dial(
    target: str, *, secret: Secret | None, limits: Limits | None = None, tls: TlsReader | None = None
) -> grpc.aio.Channel:
    """A channel to `target` that sends `secret` with every call. Connects at the first call. The caller closes it.

    With `tls` both sides prove themselves by certificates. After a renewal of the certificates, new calls use a new
    connection. The channel adds the secret itself, because gRPC's call credentials need TLS, and gRPC's interceptors
    cost a task for each call.
    """
    options = (limits or Limits()).channel_options()
    channel = _open(target, options, tls)
    metadata = call_metadata(secret.text if secret else None)
    return _AnnotatedChannel(channel, lambda: metadata) if metadata else channel


def dial_from_any_loop(
    target: str, *, secret: Secret | None, limits: Limits | None = None, tls: TlsReader | None = None
) -> grpc.aio.Channel:
    """As `dial`, but for unary calls that any event loop may make, one at a time.

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
        return _AnnotatedChannel(dial(target), lambda: cluster_metadata(cluster_id()))

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


class _AnnotatedChannel(grpc.aio.Channel):
    """A channel that adds metadata to every call of another channel."""

    def __init__(self, inner: grpc.aio.Channel, metadata: Callable[[], Metadata]) -> None:
        self._inner = inner
        self._metadata = metadata

    async def __aenter__(self) -> _AnnotatedChannel:
        await self._inner.__aenter__()
        return self

    async def __aexit__(self, *exc_info: Any) -> None:
        await self._inner.__aexit__(*exc_info)

    async def close(self, grace: float | None = None) -> None:
        """Close the connection. Calls under way have `grace` seconds."""
        await self._inner.close(grace)

    def get_state(self, try_to_connect: bool = False) -> grpc.ChannelConnectivity:
        """The state of the connection."""
        return self._inner.get_state(try_to_connect)

    async def wait_for_state_change(self, last_observed_state: grpc.ChannelConnectivity) -> None:
        """Wait until the connection has another state."""
        await self._inner.wait_for_state_change(last_observed_state)

    async def channel_ready(self) -> None:
        """Wait until the connection is made."""
        await self._inner.channel_ready()

    def unary_unary(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for one request and one response."""
        return self._annotated(self._inner.unary_unary(*args, **kwargs))

    def unary_stream(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for one request and a stream of responses."""
        return self._annotated(self._inner.unary_stream(*args, **kwargs))

    def stream_unary(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for a stream of requests and one response."""
        return self._annotated(self._inner.stream_unary(*args, **kwargs))

    def stream_stream(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for streams both ways."""
        return self._annotated(self._inner.stream_stream(*args, **kwargs))

    def _annotated(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def with_more(*args: Any, metadata: Any = None, **kwargs: Any) -> Any:
            return call(*args, metadata=(*(metadata or ()), *self._metadata()) or None, **kwargs)

        return with_more
