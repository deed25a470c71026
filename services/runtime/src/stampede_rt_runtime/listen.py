"""Where a service may listen, and whether the port is free. Checked before gRPC is asked.

gRPC binds what it can of the addresses that a name has and says nothing of the others; a port that another process
holds on 127.0.0.1 would be served on ::1 alone. So all of them are tried first.
"""

from __future__ import annotations

import errno
import ipaddress
import socket

from stampede_rt_runtime.values import Address, parse_address


class CannotListen(Exception):
    """The address cannot be listened at; the text is one line that says why."""


class NotAllowed(CannotListen):
    """The address is reachable from other machines, and nobody said that this is wanted."""


def check_listen(text: str, *, allow_insecure_anywhere: bool) -> Address:
    """The address, if it is loopback or allowed, and free. Resolving a name may block for a moment.

    Raises NotAllowed or CannotListen.
    """
    address = parse_address(text)
    socket_addresses = _resolve(address)
    if not allow_insecure_anywhere and not all(_is_loopback(socket_address) for _, socket_address in socket_addresses):
        raise NotAllowed(
            f"{address} can be reached from other machines, and without certificates everything, the secret included, "
            f"would cross the network in clear text; listen at localhost:{address.port}, or, on a network that you "
            "trust, add --allow-insecure-anywhere"
        )
    for family, socket_address in socket_addresses:
        _try_bind(address, family, socket_address)
    return address


def _resolve(address: Address) -> list[tuple[socket.AddressFamily, tuple[str, int]]]:
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (socket.gaierror, UnicodeError) as error:
        raise CannotListen(f"{address.host!r} is no name or address of this machine ({error})") from error
    return [(family, (str(socket_address[0]), int(socket_address[1]))) for family, _, _, _, socket_address in found]


def _is_loopback(socket_address: tuple[str, int]) -> bool:
    return ipaddress.ip_address(socket_address[0].partition("%")[0]).is_loopback


def _try_bind(address: Address, family: socket.AddressFamily, socket_address: tuple[str, int]) -> None:
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as gRPC does: old connections do not count
            if family == socket.AF_INET6:
                probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            probe.bind(socket_address)
    except OSError as error:
        if error.errno in (errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL) and family == socket.AF_INET6:
            return  # a machine without IPv6 whose names still have IPv6 addresses: gRPC passes over these, too
        raise CannotListen(_why(address, error)) from error


def _why(address: Address, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"{address} is in use by another process; stop that one, or choose another port with --listen"
    if error.errno == errno.EACCES:
        return f"{address} may not be listened at by this user; choose a port from 1024 up with --listen"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{address.host} is no address of this machine; choose one of its own with --listen"
    return f"{address} cannot be listened at: {error.strerror}"
