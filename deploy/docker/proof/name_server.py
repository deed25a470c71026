"""A DNS server (RFC 1035) that knows the addresses of the services. A network of Docker has such a server, too."""

from __future__ import annotations

import asyncio
import ipaddress
import struct
from collections.abc import Mapping
from typing import cast

TYPE_A, CLASS_IN = 1, 1
_HEADER = struct.Struct("!6H")
_RESPONSE, _RECURSION = 0x8400, 0x0080  # an authority's answer; recursion is available
_NO_ERROR, _NO_SUCH_NAME = 0, 3
_NAME_OF_QUESTION = 0xC00C  # a pointer to the place at which every question has its name
_TTL_SECONDS = 1


class NameServer(asyncio.DatagramProtocol):
    """Answers questions for the IPv4 addresses in `addresses`. For other types or names the answer has no records."""

    def __init__(self, addresses: Mapping[str, str]) -> None:
        self._addresses = addresses
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Called by asyncio with the socket."""
        # Before Python 3.12 the transport of a datagram socket has another class.
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Called by asyncio with every datagram. If the datagram is no question, sends no answer."""
        response = answer(data, self._addresses)
        if response is not None and self._transport is not None:
            self._transport.sendto(response, addr)


def answer(query: bytes, addresses: Mapping[str, str]) -> bytes | None:
    """Return the response to a query with one question; None for any other message. Pure."""
    try:
        number, flags, questions, *_ = _HEADER.unpack_from(query)
        name, end = _read_name(query, _HEADER.size)
        kind, _ = struct.unpack_from("!2H", query, end)
    except (struct.error, IndexError, UnicodeDecodeError):
        return None
    if questions != 1 or flags & 0x8000:
        return None
    question = query[_HEADER.size : end + 4]
    known = addresses.get(name.lower())
    record = _address_record(known) if known and kind == TYPE_A else b""
    code = _NO_ERROR if known else _NO_SUCH_NAME
    header = _HEADER.pack(number, _RESPONSE | (flags & 0x0100) | _RECURSION | code, 1, bool(record), 0, 0)
    return header + question + record


def _read_name(message: bytes, at: int) -> tuple[str, int]:
    labels = []
    while length := message[at]:
        labels.append(message[at + 1 : at + 1 + length].decode("ascii"))
        at += 1 + length
    return ".".join(labels), at + 1


def _address_record(address: str) -> bytes:
    packed = ipaddress.IPv4Address(address).packed
    return struct.pack("!3HIH", _NAME_OF_QUESTION, TYPE_A, CLASS_IN, _TTL_SECONDS, len(packed)) + packed


async def serve_names(host: str, addresses: Mapping[str, str]) -> None:
    """Answer at UDP port 53 of `host` for as long as the event loop runs."""
    loop = asyncio.get_running_loop()
    await loop.create_datagram_endpoint(lambda: NameServer(addresses), local_addr=(host, 53))
