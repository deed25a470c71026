"""The gRPC server of every service. It limits calls, checks callers, reports its health, and stops in order."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc

from stampede_rt.v1 import quota_use_service_pb2_grpc
from stampede_rt_runtime.aborts import AbortInterceptor
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.credentials import AcceptedCredentials
from stampede_rt_runtime.admission import AdmissionInterceptor
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.callers_cluster import ClusterInterceptor, JudgeCluster
from stampede_rt_runtime.capacity import CapacityInterceptor, Slots
from stampede_rt_runtime.health import Health
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.listen import CannotListen, check_listen
from stampede_rt_runtime.overload import RefusedCalls
from stampede_rt_runtime.pacing import PacingInterceptor
from stampede_rt_runtime.quotas.use_servicer import QuotaUseServicer
from stampede_rt_runtime.reflecting import describe_services, noting_names
from stampede_rt_runtime.sockets.server import SocketServer
from stampede_rt_runtime.sockets.tcp_socket import listen_over_tcp
from stampede_rt_runtime.supervision.systemd import STOPPING, notify_systemd
from stampede_rt_runtime.tls import ServiceTls
from stampede_rt_runtime.tracing import tracing_interceptors
from stampede_rt_runtime.values import Address, parse_address

logger = logging.getLogger(__name__)

DRAIN_SECONDS = 2.0  # the time that a stop waits for streams to end, and then again for calls to finish
_STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT)


class ServiceServer:
    """One listening server. Order of use: make it, `bind`, register servicers on `.grpc`, `start`, then `run` or
    `stop`.

    Make it on the event loop that serves. With `tls` every caller must bring a certificate whose role may make the
    call. With `secret` every caller must bring a secret or a client token. `secret` allows every call, and
    `client_secret` the calls of clients. If a caller brings a secret and a certificate, the role of the
    certificate decides. If it brings a token, the roles of the token decide. Without `secret` and `tls` the server
    admits every caller. `judge_cluster` decides about callers of another cluster; without it the server serves them.
    `reflection`: whether the server describes its services to every caller with a credential, as tools such as grpcurl
    ask.
    """

    def __init__(
        self,
        *,
        secret: Secret | None,
        client_secret: Secret | None = None,
        limits: Limits | None = None,
        tls: ServiceTls | None = None,
        judge_cluster: JudgeCluster | None = None,
        reflection: bool = False,
    ) -> None:
        limits = limits or Limits()
        self.access = AccessControl()  # the service gives it the directory's rules by `tell` or `draw_from`
        self.refused_calls = RefusedCalls()
        self.slots = Slots(limits)
        accepted = AcceptedCredentials(
            secrets=secret.accepted if secret else (),
            client_secrets=client_secret.accepted if client_secret else (),
            cluster=tls.identity.cluster if tls else "",
            read_token=self.access.read_token,
        )
        self._tls = tls
        # The first one is the outermost. So a refused caller takes no slot, and does not learn this server's cluster.
        interceptors = [
            AbortInterceptor(),
            AdmissionInterceptor(accepted, self.access),
            *([ClusterInterceptor(judge_cluster)] if judge_cluster else []),
            CapacityInterceptor(self.slots, self.refused_calls),
            PacingInterceptor(),
            *tracing_interceptors(),
        ]
        self.sockets = SocketServer(interceptors, limits, self.refused_calls)
        """Streams over sockets of their own. It serves no caller until it listens."""
        self.grpc: grpc.aio.Server = grpc.aio.server(
            interceptors=interceptors,
            options=limits.server_options(),
            maximum_concurrent_rpcs=limits.rpcs_max(),
        )
        self._reflection = reflection
        self._service_names = noting_names(self.grpc)
        self.address = ""
        self.stopping = asyncio.Event()
        self._health = Health()
        self._health.add_to(self.grpc)
        uses = QuotaUseServicer(self.access.accounts)
        quota_use_service_pb2_grpc.add_QuotaUseServiceServicer_to_server(uses, self.grpc)

    def bind(self, listen: str, *, allow_insecure_anywhere: bool = False) -> str:
        """Take the port at `listen`, and return the address with the bound port. Call this once. Raises CannotListen.

        From now on the port belongs to this process, and others may learn its address. Their calls wait until `start`.
        """
        checked = check_listen(listen, allow_insecure_anywhere=allow_insecure_anywhere or self._tls is not None)
        try:
            port = self._add_port(str(checked))
        except RuntimeError as error:  # another process took the port after the check
            raise CannotListen(f"the service cannot listen at {checked}: {error}") from error
        if port == 0:
            raise CannotListen(f"the service cannot listen at {checked}")
        self.address = str(Address(checked.host, port))
        return self.address

    def bind_sockets(self, port: int, *, allow_insecure_anywhere: bool = False) -> int:
        """Serve streams over TCP sockets, too, at the host of `bind` and `port`. Returns the port that is bound.

        `port`: 0 for any free one. Call this after `bind`. Raises CannotListen.
        """
        listening = listen_over_tcp(
            parse_address(self.address).host,
            port,
            allow_insecure_anywhere=allow_insecure_anywhere or self._tls is not None,
        )
        self.sockets.listen_over_tcp(listening, None if self._tls is None else self._tls.socket_context())
        return int(listening[0].getsockname()[1])

    async def start(self) -> None:
        """Serve the registered services at the bound address. With `reflection` also describe them to callers.

        Health answers NOT_SERVING until `set_serving` is called.
        """
        if self._reflection:
            describe_services(self.grpc, self._service_names)
        await self.set_serving(False)
        await self.grpc.start()

    def _add_port(self, address: str) -> int:
        if self._tls is None:
            return self.grpc.add_insecure_port(address)
        return self.grpc.add_secure_port(address, self._tls.server_credentials())

    @property
    def is_serving(self) -> bool:
        """Whether the health service says that the server is ready."""
        return self._health.is_serving

    def certificate_ends_unix_s(self) -> float | None:
        """The end of the server's own certificate, in seconds since the epoch; None: it has none."""
        return None if self._tls is None else self._tls.ends_unix_s()

    async def set_serving(self, serving: bool) -> None:
        """Set the answer of the standard health service."""
        await self._health.set_serving(serving)

    async def run(
        self,
        end_streams: Callable[[], Awaitable[Any]] | None = None,
        leave: Callable[[], Awaitable[Any]] | None = None,
    ) -> None:
        """Serve until SIGTERM, SIGINT or `stopping` is set, then `stop(end_streams)`. A second signal ends calls.

        `leave` runs before `stop`, while the server still serves. It must end by itself; a second signal ends it.
        """
        with _signals_set(self.stopping):
            await self.stopping.wait()
        logger.info("stopping", extra={"event": "stopping", "address": self.address})
        notify_systemd(STOPPING)
        hurry = asyncio.Event()
        with _signals_set(hurry):
            if leave is not None:
                await _until(leave(), hurry)
            drain = asyncio.create_task(self.stop(end_streams))
            cut = asyncio.create_task(hurry.wait())
            await asyncio.wait({drain, cut}, return_when=asyncio.FIRST_COMPLETED)
            cut.cancel()
            if not drain.done():
                await asyncio.gather(self.grpc.stop(None), self.sockets.stop(0))
            await drain

    async def stop(self, end_streams: Callable[[], Awaitable[Any]] | None = None) -> None:
        """Stop in order: health answers NOT_SERVING, `end_streams` ends open streams, calls may finish, the server
        closes.

        Takes 2 * DRAIN_SECONDS at most. Idempotent.
        """
        self.stopping.set()
        await self._health.end()
        if end_streams is not None:
            await _bounded(end_streams())
        await asyncio.gather(self.grpc.stop(DRAIN_SECONDS), self.sockets.stop(DRAIN_SECONDS))


async def _until(work: Awaitable[Any], hurry: asyncio.Event) -> None:
    """Do `work`, but only until `hurry` is set."""
    working, cut = asyncio.ensure_future(work), asyncio.create_task(hurry.wait())
    await asyncio.wait((working, cut), return_when=asyncio.FIRST_COMPLETED)
    for each in (working, cut):
        each.cancel()
    await asyncio.gather(working, cut, return_exceptions=True)


async def _bounded(work: Awaitable[Any]) -> None:
    try:
        async with asyncio.timeout(DRAIN_SECONDS):
            await work
    except TimeoutError:
        logger.warning(
            "streams did not end in time; the server ends them",
            extra={"event": "streams_cut_off", "seconds": DRAIN_SECONDS},
        )


@contextlib.contextmanager
def _signals_set(event: asyncio.Event) -> Any:
    """While entered, stop signals set `event`."""
    loop = asyncio.get_running_loop()
    for number in _STOP_SIGNALS:
        loop.add_signal_handler(number, event.set)
    try:
        yield
    finally:
        for number in _STOP_SIGNALS:
            loop.remove_signal_handler(number)


@contextlib.asynccontextmanager
async def serving(
    register: Callable[[grpc.aio.Server], Any],
    *,
    listen: str = "localhost:0",
    secret: Secret | None = None,
    client_secret: Secret | None = None,
    limits: Limits | None = None,
    tls: ServiceTls | None = None,
    judge_cluster: JudgeCluster | None = None,
) -> AsyncIterator[ServiceServer]:
    """A started server on loopback for the duration of the block. For tests and for servers inside a client."""
    server = ServiceServer(
        secret=secret, client_secret=client_secret, limits=limits, tls=tls, judge_cluster=judge_cluster
    )
    server.bind(listen)
    register(server.grpc)
    await server.start()
    await server.set_serving(True)
    try:
        yield server
    finally:
        await server.stop()
