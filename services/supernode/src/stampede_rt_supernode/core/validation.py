"""Checks the form of names, ids and endpoints. Pure. Every function raises InvalidArgument or InvalidName.

The errors name the thing, the reason and the way out, because the author of the name reads them.
"""

from __future__ import annotations

import re

from stampede_rt.errors import InvalidArgument, InvalidName
from stampede_rt.values.policy import MAX_BYTES_MIN, NAME_GRAMMAR
from stampede_rt_supernode.core.records import ID_BYTES, Endpoint

GATEKEEPERS_MAX = 16
TARGET_CHARACTERS_MAX = 256
ZONE_CHARACTERS_MAX = 64
VERSION_CHARACTERS_MAX = 64
MACHINE_CHARACTERS_MAX = 64
PLACE_CHARACTERS_MAX = 1024
GLOB_CHARACTERS_MAX = 256
_NAME = re.compile(NAME_GRAMMAR, re.ASCII)
_GLOB = re.compile(r"[A-Za-z0-9._/*?-]*", re.ASCII)


def check_name(name: str, what: str) -> None:
    """Check a name. `what` is the kind of the named thing: "channel", "host"."""
    if _NAME.fullmatch(name) is None:
        raise InvalidName(
            f"{_shown(name)} cannot name a {what}: {_fault(name)}; a name is 1 to 128 of A-Z, a-z, 0-9, '.', '_', '/' "
            "and '-', and begins with a letter or digit",
            metadata={what: name[:128]},
        )


def check_max_bytes(what: str, name: str, max_bytes: int | None) -> None:
    """Check that `max_bytes` leaves room for an item without payload.

    Only servicers make this check. The state machine does not make it, because a log of an earlier release may have
    smaller values, and all replicas must apply that log alike.
    """
    if max_bytes is not None and max_bytes < MAX_BYTES_MIN:
        raise InvalidArgument(
            f"{what} {name}: max_bytes is {max_bytes}; it must be {MAX_BYTES_MIN} or more, because an item counts as "
            f"its payload and {MAX_BYTES_MIN} bytes",
            metadata={what: name, "field": "max_bytes"},
        )


def _shown(text: str) -> str:
    return repr(text if len(text) <= 128 else text[:125] + "...")


def _fault(name: str) -> str:
    if not name:
        return "it is empty"
    if len(name) > 128:
        return f"it has {len(name)} characters"
    if name[0] in "._/-":
        return f"it begins with {name[0]!r}"
    bad = next(c for c in name if not re.fullmatch(r"[A-Za-z0-9._/-]", c, re.ASCII))
    return f"it contains {bad!r}"


def check_glob(glob: str) -> None:
    """Check a pattern for names. The empty pattern matches all names."""
    if len(glob) > GLOB_CHARACTERS_MAX:
        raise InvalidArgument(f"the pattern has {len(glob)} characters; {GLOB_CHARACTERS_MAX} at most")
    if _GLOB.fullmatch(glob) is None:
        raise InvalidArgument(
            f"{glob!r} can match no name: names have only A-Z, a-z, 0-9, '.', '_', '/' and '-'; a pattern may "
            "also have '*' for any run of characters and '?' for one"
        )


def check_id(value: bytes, field: str) -> None:
    """Check an id or request id: exactly 16 bytes. `field` is its name in the request."""
    if len(value) != ID_BYTES:
        raise InvalidArgument(
            f"{field} has {len(value)} bytes instead of {ID_BYTES}; ids are {ID_BYTES} random bytes",
            metadata={"field": field},
        )


def check_incarnation(value: int, field: str) -> None:
    """Check a boot or channel incarnation: 64 bits, not 0."""
    if not 0 < value < 2**64:
        raise InvalidArgument(
            f"{field} is {value}; choose 64 random bits, not 0, at each start", metadata={"field": field}
        )


def check_gatekeepers(endpoints: tuple[Endpoint, ...], host_name: str) -> None:
    """Check a host's endpoints: 1 to 16, each with a gRPC target."""
    if not 1 <= len(endpoints) <= GATEKEEPERS_MAX:
        raise InvalidArgument(
            f"host {host_name} states {len(endpoints)} gatekeepers; 1 to {GATEKEEPERS_MAX} are allowed",
            metadata={"host": host_name},
        )
    for endpoint in endpoints:
        check_text(endpoint.target, f"a gatekeeper of host {host_name}", 1, TARGET_CHARACTERS_MAX)
        check_text(endpoint.zone, f"a zone of host {host_name}", 0, ZONE_CHARACTERS_MAX)


def check_version(version: str, host_name: str) -> None:
    """Check a software version, which may be empty."""
    check_text(version, f"the version of host {host_name}", 0, VERSION_CHARACTERS_MAX)


def check_text(text: str, what: str, least: int, most: int, *, may_have_blanks: bool = False) -> None:
    """Check a text of `least` to `most` printable characters. `what` names the text in the error."""
    if not least <= len(text) <= most:
        raise InvalidArgument(f"{what} has {len(text)} characters; {least} to {most} are allowed")
    if not text.isprintable() or (" " in text and not may_have_blanks):
        raise InvalidArgument(f"{what} is {text!r}, which has blanks or unprintable characters; leave them out")
