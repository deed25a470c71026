"""The subject for which a quota is counted. Pure."""

from __future__ import annotations

from ipaddress import IPv4Address, IPv6Address, ip_address
from urllib.parse import unquote

from stampede_rt_runtime.access.caller import Caller, CallerKind

_NAMED = (CallerKind.CERTIFICATE, CallerKind.TOKEN)


def subject_of(caller: Caller, peer: str) -> str | None:
    """The name of a caller in quotas. None: a service of the cluster or an operator, who has no quotas.

    A caller whose credential has no name gets its address, such as "@10.0.0.3", or "@localhost" on this machine.
    `peer`: the other side in gRPC's form.
    """
    if caller.kind in _NAMED:
        return caller.name if caller.is_judged else None
    return "@" + machine_of(peer)


def creator_of(caller: Caller) -> str | None:
    """The name under which quotas count the things that a caller has created; None: they are not counted.

    It is the creator's name in the directory.
    """
    return None if caller.kind in _NAMED and not caller.is_judged else caller.name


def machine_of(peer: str) -> str:
    """The machine of the other side, which is in gRPC's form."""
    kind, _, rest = peer.partition(":")
    if kind not in ("ipv4", "ipv6"):
        return "localhost" if kind == "unix" else kind or "unknown"
    address = unquote(rest).rpartition(":")[0].strip("[]")
    try:
        return _network(ip_address(address.partition("%")[0]))
    except ValueError:
        return address


def _network(address: IPv4Address | IPv6Address) -> str:
    """The text that represents the machine of an address: a machine usually has all addresses of a /64 of IPv6."""
    if isinstance(address, IPv6Address) and address.ipv4_mapped is not None:
        address = address.ipv4_mapped
    if address.is_loopback:
        return "localhost"
    return str(address) if isinstance(address, IPv4Address) else f"{IPv6Address(int(address) >> 64 << 64)}/64"
