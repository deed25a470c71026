"""The form and meaning of values in flags, environment variables and settings files. Pure.

Every parser takes the text and returns the value. It raises ValueError with the allowed form, and without the text
itself, because the caller names the setting and its value.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from stampede_rt.errors import InvalidArgument
from stampede_rt.values import timeline

_SIZE = re.compile(r"(\d+)\s*(B|KiB|MiB|GiB)?", re.ASCII)
_BYTES = {None: 1, "B": 1, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
_TRUE = frozenset({"1", "true", "yes", "on"})
_FALSE = frozenset({"0", "false", "no", "off"})


@dataclass(frozen=True, slots=True)
class Address:
    """An address to listen at or to call. `host` has no brackets. `port` is 0..65535; 0 means any free port."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse_address(text: str) -> Address:
    """The address of `HOST:PORT`, with an IPv6 host in brackets. Raises ValueError."""
    host, colon, port = text.strip().rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    host = host[1:-1] if bracketed else host
    well_formed = colon and host and port.isascii() and port.isdigit() and (bracketed or ":" not in host)
    if not well_formed or any(c.isspace() or c in "/[]" for c in host) or int(port) > 65535:
        raise ValueError('HOST:PORT with a port from 0 to 65535, such as "localhost:7580" or "[::1]:7580"')
    return Address(host, int(port))


def parse_address_text(text: str) -> str:
    """Like `parse_address`, but returns the normalised text, which gRPC accepts."""
    return str(parse_address(text))


def parse_target(text: str) -> str:
    """An address to call: `HOST:PORT` with a port above 0. Raises ValueError."""
    address = parse_address(text)
    if address.port == 0:
        raise ValueError(
            "HOST:PORT with a port from 1 to 65535; a service can listen at port 0, but no caller can call it"
        )
    return str(address)


def parse_duration(text: str) -> int:
    """A duration such as `30ms` or `5s`, in nanoseconds, 0 or more. Raises ValueError."""
    try:
        nanos = timeline.parse_duration(text)
    except InvalidArgument:
        nanos = -1
    if nanos < 0:
        raise ValueError('a duration with its unit (ns, us, ms, s, m, h, d), such as "5s" or "30ms"')
    return nanos


def parse_size(text: str) -> int:
    """A number of bytes such as `64KiB` or `20MiB`. Raises ValueError."""
    match = _SIZE.fullmatch(text.strip())
    if match is None:
        raise ValueError('a number of bytes, such as "65536", "64KiB" or "20MiB"')
    number, unit = match.groups()
    return int(number) * _BYTES[unit]


def format_size(count: int) -> str:
    """A number of bytes in the form of `parse_size`, in the largest unit that gives a whole number."""
    for unit in ("GiB", "MiB", "KiB"):
        if count and count % _BYTES[unit] == 0:
            return f"{count // _BYTES[unit]} {unit}"
    return f"{count} B"


def parse_bool(text: str) -> bool:
    """A yes or no. Raises ValueError."""
    word = text.strip().lower()
    if word not in _TRUE | _FALSE:
        raise ValueError("true or false")
    return word in _TRUE


def parse_int(text: str) -> int:
    """A whole number. Raises ValueError."""
    try:
        return int(text)
    except ValueError:
        raise ValueError("a whole number") from None


def parse_list(parse_one: Callable[[str], str]) -> Callable[[str], tuple[str, ...]]:
    """A parser of a comma-separated list. Empty text gives an empty tuple."""

    def parse(text: str) -> tuple[str, ...]:
        return tuple(parse_one(part) for part in (piece.strip() for piece in text.split(",")) if part)

    return parse
