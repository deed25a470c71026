"""The gRPC connections of one session, one for each address."""

from __future__ import annotations

from stampede_rt.transports.concurrency_async import Mutex
from stampede_rt.transports.grpc_async import Port

PORTS_MAX = 1024


class Ports:
    """Opens a port at its first use and keeps it; beyond a bound the longest unused one is let go."""

    def __init__(self, secret: str | None) -> None:
        self._secret = secret
        self._ports: dict[str, Port] = {}
        self._mutex = Mutex()

    def to(self, target: str) -> Port:
        """The port to `target`."""
        with self._mutex:
            port = self._ports.pop(target, None) or Port(target, self._secret)
            self._ports[target] = port
            if len(self._ports) > PORTS_MAX:
                self._ports.pop(next(iter(self._ports)))
            return port

    async def aclose(self) -> None:
        """End everything that is under way."""
        with self._mutex:
            ports = list(self._ports.values())
            self._ports.clear()
        for port in ports:
            await port.aclose()
