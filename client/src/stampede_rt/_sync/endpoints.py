# Generated from ../_async by tools/generate.py; do not edit.
"""The connections of one session, one for each address."""

from __future__ import annotations

from stampede_rt.cluster.call_metadata import CallMetadata
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import Unavailable
from stampede_rt.security.credentials import Credentials
from stampede_rt.transports import forking
from stampede_rt.transports.concurrency_sync import EventLoopCheck, Mutex, process_check
from stampede_rt.transports.grpc_sync import ServerEndpoint

ENDPOINTS_MAX = 1024


class EndpointPool:
    """Opens an endpoint at its first use, and keeps it. Beyond ENDPOINTS_MAX it drops the least recently used one.

    When the certificates change, the pool opens new endpoints, which use the new certificates. A stream under way keeps
    the certificates with which it began.
    """

    def __init__(self, credentials: Credentials, transport: Transport = Transport.GRPC) -> None:
        forking.opened(self)
        self._forks = forking.forks()
        self._event_loop = EventLoopCheck()
        self.check_process = process_check(self._forks, self._event_loop)
        """Raises ForkedProcess in a forked child, and WrongEventLoop on another event loop than the connection's.

        Call this before you take a lock: a child may have inherited the lock in the locked state. Each put and each
        step of a subscription calls it, so it is one function.
        """
        self.credentials = credentials
        self._transport = transport
        self.metadata = CallMetadata(credentials.present_secret)
        self._material = credentials.material()  # the certificates of the endpoints
        self._endpoints: dict[str, ServerEndpoint] = {}
        self._former: list[ServerEndpoint] = []  # endpoints with earlier certificates, perhaps with open streams
        self._mutex = Mutex()
        self.closed = False

    def to(self, target: str) -> ServerEndpoint:
        """Return the endpoint to `target`. Raises Unavailable when the pool is closed."""
        self.check_process()
        with self._mutex:
            if self.closed:
                raise connection_closed()
            self._look_at_certificates()
            endpoint = self._endpoints.pop(target, None)
            if endpoint is None or endpoint.is_stuck:
                endpoint = ServerEndpoint(target, self.metadata, self._material, self._transport)
            self._endpoints[target] = endpoint
            if len(self._endpoints) > ENDPOINTS_MAX:
                self._endpoints.pop(next(iter(self._endpoints)))
            return endpoint

    @property
    def inherited(self) -> bool:
        """Whether the endpoints were opened before a fork of this process. They do not work in the child."""
        return self._forks != forking.forks()

    def check_thread(self) -> None:
        """Raise WrongEventLoop unless this thread runs the connection's event loop."""
        if not self.inherited:  # in a forked child nothing runs that loop
            self._event_loop.check_thread()

    def _look_at_certificates(self) -> None:
        material = self.credentials.material()
        if material is not self._material:
            self._material = material
            self._former = list(self._endpoints.values())
            self._endpoints.clear()

    def close(self) -> None:
        """End all calls and streams, and wait for their end.

        If `close` is interrupted while it waits, the calls and streams end nevertheless.
        """
        with self._mutex:
            self.closed = True
            endpoints = [*self._former, *self._endpoints.values()]
            self._former.clear()
            self._endpoints.clear()
        for endpoint in endpoints:
            endpoint.close()
        forking.closed(self)
        for endpoint in endpoints:
            endpoint.ended()


def connection_closed() -> Unavailable:
    """Return the error of every call on a closed connection, and of calls that wait while the connection closes."""
    return Unavailable("this connection is closed; call connect() again")
