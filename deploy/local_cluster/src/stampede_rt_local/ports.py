"""Free ports for services that must know each other's address before they start."""

from __future__ import annotations

import random
import socket

# Below the ephemeral range of every system (Linux: from 32768 on), so that no outgoing connection takes the port.
PORTS = range(15_000, 32_000)
_TRIES_MAX = 200


def free_ports(count: int, host: str = "localhost", *, besides: int = 0) -> list[int]:
    """Return `count` different ports that are free at `host` now, without `besides`.

    They are random, so that clusters at the same time seldom use the same ports. Raises OSError if there are none.
    """
    found: list[int] = []
    for port in random.sample(PORTS, _TRIES_MAX):
        if len(found) == count:
            break
        if port != besides and _is_free(host, port):
            found.append(port)
    if len(found) < count:
        raise OSError(f"no {count} free ports at {host} between {PORTS[0]} and {PORTS[-1]}")
    return found


def _is_free(host: str, port: int) -> bool:
    for family, kind, protocol, _, place in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        try:
            with socket.socket(family, kind, protocol) as probe:
                probe.bind(place)
        except OSError:
            return False
    return True
