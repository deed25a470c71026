"""This machine's addresses: which of them other machines can call, and which only this machine can."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable
from urllib.parse import unquote

from stampede_rt.cluster.addresses import is_loopback
from stampede_rt_runtime.listen import CannotListen
from stampede_rt_runtime.values import parse_address


def address_towards(targets: Iterable[str]) -> str:
    """The address of this machine that the first target on another machine can call.

    "localhost" if all targets are on this machine. Sends nothing: connects a datagram socket and reads its own address.
    May block for a moment, to resolve a name. Raises CannotListen if there is no route.
    """
    for target in targets:
        if not is_loopback(target):
            found = _own_address_towards(target)
            return "localhost" if ipaddress.ip_address(found.partition("%")[0]).is_loopback else found
    return "localhost"


def _own_address_towards(target: str) -> str:
    peer_address = parse_address(target)
    try:
        family, _, _, _, address = socket.getaddrinfo(peer_address.host, peer_address.port, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect(address)
            return str(probe.getsockname()[0])
    except (OSError, UnicodeError) as error:
        raise CannotListen(
            f"no address of this machine is known to lead to {target} ({error}); start {peer_address.host} first, "
            "correct its name, or say with --listen HOST:PORT which address this service has"
        ) from error


def is_of_another_machine(peer: str) -> bool:
    """Whether a caller, as gRPC names it ("ipv4:10.0.0.3:5", "ipv6:%5B::1%5D:5"), is on another machine."""
    kind, _, rest = peer.partition(":")
    if kind not in ("ipv4", "ipv6"):
        return False
    address = unquote(rest).rpartition(":")[0].strip("[]")
    try:
        with socket.socket(socket.AF_INET6 if kind == "ipv6" else socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((address, 0))  # the system allows it only for the machine's own addresses
    except OSError:
        return True
    return False
