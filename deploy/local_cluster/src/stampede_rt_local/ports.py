"""Free ports for services that must know each other's address before they start.

Between the choice of a port and the start of its service, and while the service restarts, another program could take
the port. So each process takes its ports from blocks that no other process of the same user has. Two runs of the tests
at the same time therefore never use the same port.
"""

from __future__ import annotations

import fcntl
import os
import random
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

# Below the ephemeral range of every system (Linux: from 32768 on), so that no outgoing connection takes the port.
PORTS = range(15_000, 32_000)
BLOCK_PORTS = 250


class PortBlocks:
    """The blocks of this process. For each block the process locks a byte of the file `path`, until it ends."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: int | None = None
        self._pid = 0  # the process that has the locks; a forked process has none
        self._ports: list[int] = []  # the ports of the blocks, in the order in which they were last taken

    def ports(self) -> Iterator[int]:
        """The ports of this process, least recently used first, then the ports of further blocks, which it claims."""
        if self._file is None or self._pid != os.getpid():
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            self._pid, self._ports = os.getpid(), []
        yield from self._ports[:]
        blocks = PORTS[::BLOCK_PORTS]
        for first in random.SystemRandom().sample(blocks, len(blocks)):  # `random` has one seed in all property tests
            if first not in self._ports and self._claim(self._file, first):
                yield from range(first, first + BLOCK_PORTS)

    def take(self, port: int) -> None:
        """Note that `port` is in use from now on."""
        self._ports.remove(port)
        self._ports.append(port)

    def _claim(self, file: int, first: int) -> bool:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, first)
        except OSError:  # another process has the block
            return False
        self._ports += range(first, first + BLOCK_PORTS)
        return True


_blocks = PortBlocks(Path(tempfile.gettempdir()) / f"stampede-ports-{os.geteuid()}")


def free_ports(count: int, host: str = "localhost", *, excluded: int = 0) -> list[int]:
    """Return `count` different ports that are free at `host` now. Leaves out the port `excluded`.

    No other process of the same user gets them while this one runs. Raises OSError if there are none.
    """
    found: list[int] = []
    for port in _blocks.ports():
        if port != excluded and _is_free(host, port):
            found.append(port)
        if len(found) == count:
            break
    if len(found) < count:
        raise OSError(f"no {count} free ports at {host} between {PORTS[0]} and {PORTS[-1]}")
    for port in found:
        _blocks.take(port)
    return found


def _is_free(host: str, port: int) -> bool:
    for family, kind, protocol, _, place in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        try:
            with socket.socket(family, kind, protocol) as probe:
                probe.bind(place)
        except OSError:
            return False
    return True
