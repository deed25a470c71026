"""The gRPC connections of one session, one for each address."""

from __future__ import annotations

from stampede_rt.errors import Unavailable
from stampede_rt.security.credentials import Credentials
from stampede_rt.transports import forking
from stampede_rt.transports.concurrency_async import Mutex
from stampede_rt.transports.grpc_async import Port

PORTS_MAX = 1024


class Ports:
    """Opens a port at its first use and keeps it; beyond a bound the longest unused one is let go.

    Certificates that change count for new ports: what is under way goes on where it began, what comes next does not.
    """

    def __init__(self, credentials: Credentials) -> None:
        forking.opened(self)
        self._forks = forking.forks()
        self.credentials = credentials
        self._material = credentials.material()
        self._ports: dict[str, Port] = {}
        self._former: list[Port] = []  # of the certificates before; their streams may still be read
        self._mutex = Mutex()
        self.closed = False

    def to(self, target: str) -> Port:
        """The port to `target`. Raises Unavailable once these are closed."""
        self.check_process()
        with self._mutex:
            if self.closed:
                raise Unavailable("this connection is closed; connect() again")
            self._look_at_certificates()
            port = self._ports.pop(target, None) or Port(target, self.credentials.secret, self._material)
            self._ports[target] = port
            if len(self._ports) > PORTS_MAX:
                self._ports.pop(next(iter(self._ports)))
            return port

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
            self._former = list(self._ports.values())
            self._ports.clear()

    async def aclose(self) -> None:
        """End everything that is under way. Interrupted, it has ended all the same, and only was not waited for."""
        with self._mutex:
            self.closed = True
            ports = [*self._former, *self._ports.values()]
            self._former.clear()
            self._ports.clear()
        for port in ports:
            await port.aclose()
        forking.closed(self)
        for port in ports:
            await port.ended()
