"""The opening of a stream over a socket, and the state of its frames and bytes."""

from __future__ import annotations

import fcntl
import termios
from typing import Any

from stampede_rt.errors import DeadlineExceeded, InvalidArgument
from stampede_rt.v1 import socket_stream_pb2 as pb


def opening_in(body: bytes) -> pb.StreamOpening:
    """The opening in a frame. Raises InvalidArgument."""
    try:
        return pb.StreamOpening.FromString(body)
    except Exception as error:  # any error of a generated parser comes from the caller's bytes
        raise InvalidArgument(f"the {len(body)} bytes that were sent are no StreamOpening") from error


def unfinished(seconds: float, received_bytes: int) -> DeadlineExceeded:
    """The error for a frame if only some of its bytes came within that time."""
    return DeadlineExceeded(
        f"{received_bytes} bytes of a frame came, but the rest did not come within {seconds:g} s; send smaller "
        "messages, or use a faster network"
    )


def unread_by_peer(connected: Any) -> bool:
    """Whether the peer has not taken all bytes yet. Such a peer needs no sign of life.

    Over TCP the peer's system takes bytes for the peer, until its buffer is full.
    """
    return fcntl.ioctl(connected, termios.TIOCOUTQ, bytes(4)) != bytes(4)
