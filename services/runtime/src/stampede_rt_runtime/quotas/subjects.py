"""Whom a quota is counted for. Pure."""

from __future__ import annotations

from ipaddress import AddressValueError, IPv6Address
from urllib.parse import unquote

from stampede_rt_runtime.access.caller import Caller, CallerKind

_NAMED = (CallerKind.CERTIFICATE, CallerKind.TOKEN)


def subject_of(caller: Caller, peer: str) -> str | None:
    """The name that quotas know a caller by. None: it has none, as a member of the cluster or an operator.

    A caller whose proof bears no name goes by its address, "@10.0.0.3". `peer`: as gRPC names the other side.
    """
    if caller.kind in _NAMED:
        return caller.name if caller.is_judged else None
    return "@" + _address(peer)


def _address(peer: str) -> str:
    kind, _, rest = peer.partition(":")
    if kind not in ("ipv4", "ipv6"):
        return kind or "unknown"
    address = unquote(rest).rpartition(":")[0].strip("[]")
    return address if kind == "ipv4" else _network(address)


def _network(address: str) -> str:
    """One machine commands a whole /64 of IPv6 addresses."""
    try:
        parsed = IPv6Address(address.partition("%")[0])
    except AddressValueError:
        return address
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return str(parsed) if parsed.is_loopback else f"{IPv6Address(int(parsed) >> 64 << 64)}/64"
