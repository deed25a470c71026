"""Addresses of front-ends, as people write them. Pure."""

from __future__ import annotations

import ipaddress
import re

from stampede_rt.errors import InvalidArgument

DEFAULT_PORT = 7580
DEFAULT_URL = f"localhost:{DEFAULT_PORT}"
ADDRESSES_MAX = 16  # in one URL
_LOOPBACK_NAMES = ("localhost", "ip6-localhost", "ip6-loopback")


def parse_addresses(url: str) -> tuple[str, ...]:
    """Return the gRPC targets of `"host:port,host:port"`; the default port is 7580. `unix:/path` stays as it is.

    Raises InvalidArgument.
    """
    if not isinstance(url, str):
        raise InvalidArgument(f'the address is {url!r}; give it as text, as in "localhost:7580"')
    parts = [part.strip() for part in url.removeprefix("stampede://").split(",") if part.strip()]
    if not 1 <= len(parts) <= ADDRESSES_MAX:
        raise InvalidArgument(f'the address is {url!r}; write 1 to {ADDRESSES_MAX} addresses, as in "localhost:7580"')
    return tuple(_parse_one(part) for part in parts)


def is_loopback(target: str) -> bool:
    """Whether `HOST:PORT` or `unix:PATH` certainly belongs to this machine. Resolves no name.

    A name that only begins with "localhost" or with "127." may belong to another machine.
    """
    if target.startswith("unix:"):
        return True
    host = target.rpartition(":")[0].strip("[]").lower()
    if host in _LOOPBACK_NAMES:
        return True
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:
        return False


def _parse_one(address: str) -> str:
    if address.startswith("unix:"):
        return address
    if "/" in address:
        raise InvalidArgument(f'the address is {address!r}; write only a host and a port, as in "rig:7580"')
    host, separator, port = address.rpartition(":")
    if not separator or (":" in host and not host.endswith("]")):
        host, port = f"[{address}]" if ":" in address else address, str(DEFAULT_PORT)
    if not _is_host(host) or not re.fullmatch(r"[0-9]{1,5}", port) or not 0 < int(port) < 65536:
        raise InvalidArgument(f'the address is {address!r}; write a host and a port from 1 to 65535, as in "rig:7580"')
    return f"{host}:{port}"


def _is_host(host: str) -> bool:
    """Whether `host` is a name, an IPv4 address, or an IPv6 address in brackets. Services take the same forms."""
    bracketed = host.startswith("[") and host.endswith("]")
    bare = host[1:-1] if bracketed else host
    return bool(bare) and (bracketed or ":" not in bare) and bare.isprintable() and not re.search(r"[\s/\[\]]", bare)
