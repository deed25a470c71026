"""UDP sockets that have joined a multicast group."""

from __future__ import annotations

import ipaddress
import socket
import threading
from contextlib import suppress
from typing import Any

from stampede_rt.multicast.layout import DATAGRAM_BYTES_MAX
from stampede_rt.transports import forking

RESOLVE_S_MAX = 2.0
DATAGRAMS_PER_POLL = 32  # a reader opens and checks them in about 2 ms, also if each is a whole message
RECEIVED_BYTES_MAX = 8 * 2**20  # the kernel allows less, unless net.core.rmem_max is raised


def join_group(group: str, target: str) -> socket.socket:
    """Return a socket that receives the datagrams of the group "ADDRESS:PORT". It does not block.

    The socket joins at the interface over which this machine reaches `target`, "HOST:PORT". Blocks for at most
    RESOLVE_S_MAX, to resolve a name. Raises OSError, and ValueError for an address that is not an IPv4 multicast group.
    """
    address, _, port = group.rpartition(":")
    if not ipaddress.IPv4Address(address).is_multicast:
        raise ValueError(f"{address} is not a multicast group")
    interface = _address_towards(target)
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.setblocking(False)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # other programs receive the same datagrams
        with suppress(OSError):
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVED_BYTES_MAX)
        made.bind((address, int(port)))
        membership = socket.inet_aton(address) + socket.inet_aton(interface)
        made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except BaseException:
        made.close()
        raise
    forking.keep_out_of_children(made)  # otherwise this machine would stay in the group as long as a child runs
    return made


def received(joined: socket.socket) -> list[bytes]:
    """Return the datagrams that have come, at most DATAGRAMS_PER_POLL. Does not block."""
    datagrams = list[bytes]()
    try:
        while len(datagrams) < DATAGRAMS_PER_POLL:
            datagrams.append(joined.recv(DATAGRAM_BYTES_MAX + 1))
    except OSError:  # none is left, or the interface is down: then the reader notices the silence
        pass
    return datagrams


def _address_towards(target: str) -> str:
    """The IPv4 address of this machine from which it reaches `target`."""
    host, _, port = target.rpartition(":")
    address = _resolved(host.strip("[]"), int(port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(address)
        return str(probe.getsockname()[0])


def _resolved(host: str, port: int) -> tuple[Any, ...]:
    """The IPv4 address of a name. Raises OSError. The resolver may take minutes, so it runs on a thread of its own."""
    found = list[tuple[Any, ...]]()

    def resolve() -> None:
        with suppress(OSError):
            found.append(socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4])

    resolving = threading.Thread(target=resolve, name="stampede resolves", daemon=True)
    resolving.start()
    resolving.join(RESOLVE_S_MAX)
    if not found:
        raise OSError(f"{host} has no IPv4 address, or no name server gave it within {RESOLVE_S_MAX:g} s")
    return found[0]
