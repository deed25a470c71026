"""The program's choice of a transport for streams of data. Pure, except for the look at the environment."""

from __future__ import annotations

import os
from enum import StrEnum

from stampede_rt.errors import InvalidArgument

VARIABLE = "STAMPEDE_TRANSPORT"


class Transport(StrEnum):
    """A transport for the streams between a client and a host."""

    GRPC = "grpc"
    SOCKET = "socket"
    """A Unix or TCP socket for each stream. If that is impossible, the program gets an error."""
    TCP = "tcp"
    """A TCP socket for each stream, also to a host on the same machine. If that is impossible, the program gets an
    error.
    """
    SHARED = "shared"
    """Like SOCKET, and also memory that the host shares for reads of the newest items. If that is impossible, the
    program gets an error.
    """
    BEST = "best"
    """The first transport that the host's gatekeeper offers, or gRPC if it offers none."""


def parse_transport(given: str | None) -> Transport:
    """Return the choice that `connect(transport=...)` states, or `$STAMPEDE_TRANSPORT` if it states none.

    Raises InvalidArgument.
    """
    stated = given if given is not None else os.environ.get(VARIABLE) or Transport.BEST
    try:
        return Transport(stated)
    except ValueError:
        where = "transport" if given is not None else f"${VARIABLE}"
        raise InvalidArgument(f'{where} is {stated!r}; give "best", "grpc", "socket", "tcp" or "shared"') from None
