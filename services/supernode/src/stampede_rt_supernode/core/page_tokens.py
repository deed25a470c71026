"""Writes and reads page tokens. A token says where the next page begins; callers treat it as opaque. Pure."""

from __future__ import annotations

import base64
import binascii

from stampede_rt.errors import InvalidArgument


def write_name(name: str | None) -> str:
    """The token of the page after `name`; empty if `name` is None, because no page follows."""
    return "" if name is None else base64.urlsafe_b64encode(name.encode()).decode()


def read_name(token: str) -> str:
    """The name in a token, empty for an empty token. Raises InvalidArgument."""
    try:
        return _unpack(token).decode()
    except UnicodeDecodeError:
        raise _bad(token) from None


def write_host(key: tuple[str, bytes] | None) -> str:
    """The token of the page after the host of that (name, id); empty if `key` is None, because no page follows."""
    return "" if key is None else base64.urlsafe_b64encode(key[0].encode() + b"\0" + key[1]).decode()


def read_host(token: str) -> tuple[str, bytes]:
    """The (name, id) in a token; both are empty for an empty token. Raises InvalidArgument."""
    name, _, host_id = _unpack(token).partition(b"\0")
    try:
        return name.decode(), host_id
    except UnicodeDecodeError:
        raise _bad(token) from None


def write_listing(listing: str, name: str | None) -> str:
    """The token of the page of a listing after `name`; empty if `name` is None, because no page follows.

    `listing`: a text with the kind and filters of the listing.
    """
    return "" if name is None else base64.urlsafe_b64encode(f"{listing}\0{name}".encode()).decode()


def read_listing(token: str, listing: str) -> str:
    """The name in a token, empty for an empty token. Raises InvalidArgument, also for a token of another listing."""
    token_listing, _, name = read_name(token).rpartition("\0")
    if token and token_listing != listing:
        raise InvalidArgument("the page token belongs to another listing; ask for each page with the same filters")
    return name


def write_position(listing: str, position: tuple[bool, str] | None) -> str:
    """Write the token of a position in a listing of two parts.

    A position has two values: whether it is in the second part, and a name.
    """
    return write_listing(listing, None if position is None else f"{int(position[0])}{position[1]}")


def read_position(token: str, listing: str) -> tuple[bool, str]:
    """The position in a token; for an empty token, the beginning. Raises the errors of `read_listing`."""
    text = read_listing(token, listing)
    return text[:1] == "1", text[1:]


def write_peer(listing: str, key: tuple[bool, str, bytes] | None) -> str:
    """Write the token of the page after a peer. `key`: whether the peer has no name, its name, and its id."""
    return write_listing(listing, None if key is None else f"{int(key[0])}{key[2].hex()}{key[1]}")


def read_peer(token: str, listing: str) -> tuple[bool, str, bytes]:
    """The key of the peer in a token; for an empty token, the beginning. Raises the errors of `read_listing`."""
    text = read_listing(token, listing)
    try:
        return text[:1] == "1", text[33:], bytes.fromhex(text[1:33])
    except ValueError:
        raise _bad(token) from None


def _unpack(token: str) -> bytes:
    try:
        return base64.b64decode(token.encode(), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError):
        raise _bad(token) from None


def _bad(token: str) -> InvalidArgument:
    return InvalidArgument(
        f"the page token {token[:64]!r} cannot be read; give the next_page_token of the last page, or leave it "
        "empty to begin"
    )
