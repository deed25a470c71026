"""The gRPC connections of one session, one for each address."""

from __future__ import annotations

from stampede_rt.errors import Unavailable
from stampede_rt.security.credentials import Credentials
from stampede_rt.transports import forking
from stampede_rt.transports.concurrency_async import Mutex
from stampede_rt.transports.grpc_async import ServerEndpoint

ENDPOINTS_MAX = 1024


class EndpointPool:
    """Opens an endpoint at its first use and keeps it; beyond a bound the pool lets the longest unused one go.

    Certificates that change count for new endpoints. A stream that is under way goes on with the certificates before.
    """

    def __init__(self, credentials: Credentials) -> None:
        forking.opened(self)
        self._forks = forking.forks()
        self.credentials = credentials
        self._material = credentials.material()
        self._endpoints: dict[str, ServerEndpoint] = {}
        self._former: list[ServerEndpoint] = []  # of the certificates before; their streams may still be read
        self._mutex = Mutex()
        self.closed = False

    def to(self, target: str) -> ServerEndpoint:
        """The endpoint to `target`. Raises Unavailable once these are closed."""
        self.check_process()
        with self._mutex:
            if self.closed:
                raise Unavailable("this connection is closed; connect() again")
            self._look_at_certificates()
            endpoint = self._endpoints.pop(target, None) or ServerEndpoint(
                target, self.credentials.secret, self._material
            )
            self._endpoints[target] = endpoint
            if len(self._endpoints) > ENDPOINTS_MAX:
                self._endpoints.pop(next(iter(self._endpoints)))
            return endpoint

    @property
    def inherited(self) -> bool:
        """They were opened before this process was forked, and are of no use in it."""
        return self._forks != forking.forks()

    def check_process(self) -> None:
        """Raises ForkedProcess if they are inherited. Locks may be held for good then, so this goes before them."""
        forking.check(self._forks)

    def _look_at_certificates(self) -> None:
        material = self.credentials.material()
        if material is not self._material:
            self._material = material
            self._former = list(self._endpoints.values())
            self._endpoints.clear()

    async def aclose(self) -> None:
        """End everything that is under way. Interrupted, it has ended all the same, and only was not waited for."""
        with self._mutex:
            self.closed = True
            endpoints = [*self._former, *self._endpoints.values()]
            self._former.clear()
            self._endpoints.clear()
        for endpoint in endpoints:
            await endpoint.aclose()
        forking.closed(self)
        for endpoint in endpoints:
            await endpoint.ended()
