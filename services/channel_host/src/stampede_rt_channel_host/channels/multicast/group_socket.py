"""The socket from which a host sends datagrams to its multicast group, at a bounded rate."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import socket
from collections.abc import Callable, Sequence
from contextlib import suppress

from stampede_rt.multicast.layout import ENCRYPTION_BYTES
from stampede_rt_channel_host.core.token_bucket import TokenBucket

logger = logging.getLogger(__name__)

BURST_BYTES = 2**16  # a receiver's socket buffers this by default while its program does something else
DATAGRAMS_PER_STEP = 32  # about 0.3 ms of the event loop
HOPS = 1  # routers do not pass the datagrams on
SENT_BYTES_MAX = 2**20  # the kernel's queue


class MulticastGroup:
    """The group, and the counts of its datagrams. Order of use, on one event loop: make it, `send`, `close`.

    `address`: "GROUP:PORT". `interface`: the address of the interface of this machine that sends the datagrams; empty:
    the system chooses. Raises OSError if the machine has no such interface.
    """

    def __init__(self, address: str, interface: str, bytes_per_second: int) -> None:
        group, _, port = address.rpartition(":")
        self.address, self._to = address, (group, int(port))
        self.datagrams = self.bytes = self.unsent = 0
        self._bucket = TokenBucket(bytes_per_second, BURST_BYTES, 0.0)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._set_up(interface)
        except BaseException:
            self._socket.close()
            raise

    def _set_up(self, interface: str) -> None:
        self._socket.setblocking(False)
        with suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_BYTES_MAX)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, HOPS)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)  # for readers of this machine, too
        if interface:
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(interface))

    async def send(self, parts: Sequence[bytes], encrypt: Callable[[bytes], bytes]) -> None:
        """Send the datagrams of these parts, when the rate allows it. `encrypt` makes one just before it is sent.

        Datagrams that the machine does not take are counted as unsent.
        """
        for at in range(0, len(parts), DATAGRAMS_PER_STEP):
            some = parts[at : at + DATAGRAMS_PER_STEP]
            datagram_bytes = sum(map(len, some)) + len(some) * ENCRYPTION_BYTES
            await asyncio.sleep(self._bucket.spend(datagram_bytes, asyncio.get_running_loop().time()))
            for part in some:
                self._send(encrypt(part))

    def _send(self, datagram: bytes) -> None:
        try:
            self._socket.sendto(datagram, self._to)
        except OSError as error:  # also a full queue: readers ask for the items
            self.unsent += 1
            if self.unsent & (self.unsent - 1) == 0:
                logger.warning("a datagram was not sent: %s", error, extra={"event": "multicast_unsent"})
            return
        self.datagrams += 1
        self.bytes += len(datagram)

    def close(self) -> None:
        """Close the socket. Idempotent."""
        self._socket.close()


def loopback_or_empty(host: str) -> str:
    """The IPv4 address of `host` if it is one, for the interface of the datagrams; else empty."""
    name = "127.0.0.1" if host == "localhost" else host
    try:
        address = ipaddress.IPv4Address(name)
    except ValueError:
        return ""
    return "" if address.is_unspecified else str(address)
