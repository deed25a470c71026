"""Checks whether a service may listen at an address, and whether the port is free. Runs before gRPC binds the port.

If a name has several addresses, gRPC binds the addresses that it can bind, and does not report the others. If another
process held a port on 127.0.0.1, gRPC would serve only on ::1. So this module tries all addresses first.
"""

from __future__ import annotations

import errno
import ipaddress
import socket

from stampede_rt_runtime.values import Address, parse_address


class CannotListen(Exception):
    """The service cannot listen at the address. The text is one line with the reason."""


class AddressNotAllowed(CannotListen):
    """Other machines can reach the address, and no setting allows that."""


def check_listen(text: str, *, allow_insecure_anywhere: bool, flag: str = "--listen") -> Address:
    """The address, if it is loopback or allowed, and free. May block for a moment, to resolve a name.

    `flag`: the flag of the address, for error texts. Raises AddressNotAllowed or CannotListen.
    """
    address = parse_address(text)
    socket_addresses = _resolve(address)
    if not allow_insecure_anywhere and not all(_is_loopback(socket_address) for _, socket_address in socket_addresses):
        raise AddressNotAllowed(
            f"{address} can be reached from other machines, and without certificates everything, the secret included, "
            f"would cross the network in clear text; listen at localhost:{address.port}, or, on a network that you "
            "trust, add --allow-insecure-anywhere"
        )
    for family, socket_address in socket_addresses:
        _try_bind(address, family, socket_address, flag)
    return address


def is_loopback_address(address: Address) -> bool:
    """Whether only this machine can reach the address. May block for a moment. Raises CannotListen."""
    return all(_is_loopback(socket_address) for _, socket_address in _resolve(address))


def _resolve(address: Address) -> list[tuple[socket.AddressFamily, tuple[str, int]]]:
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (socket.gaierror, UnicodeError) as error:
        raise CannotListen(f"{address.host!r} is not a name or address of this machine ({error})") from error
    return [(family, (str(socket_address[0]), int(socket_address[1]))) for family, _, _, _, socket_address in found]


def _is_loopback(socket_address: tuple[str, int]) -> bool:
    return ipaddress.ip_address(socket_address[0].partition("%")[0]).is_loopback


def _try_bind(address: Address, family: socket.AddressFamily, socket_address: tuple[str, int], flag: str) -> None:
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            # as gRPC does: old connections do not block the port
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            probe.bind(socket_address)
    except OSError as error:
        if error.errno in (errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL) and family == socket.AF_INET6:
            return  # a machine without IPv6 whose names still have IPv6 addresses; gRPC ignores these, too
        raise CannotListen(_why(address, error, flag)) from error


def _why(address: Address, error: OSError, flag: str) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"{address} is in use by another process; stop that one, or choose another port with {flag}"
    if error.errno == errno.EACCES:
        return f"this user may not listen at {address}; choose a port from 1024 up with {flag}"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"{address.host} is not an address of this machine; choose one of its own with {flag}"
    return f"the service cannot listen at {address}: {error.strerror}"
