"""Standard input as payloads. Ctrl-C ends each wait for it: Python's own read would wait for the next line."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Iterator

from stampede_rt.cli.interrupts import interruption
from stampede_rt.errors import InvalidArgument, StampedeError

PAYLOAD_BYTES_MAX = 16 * 1024 * 1024
LOOK_S = 0.1  # how often a wait looks for Ctrl-C
_READ_BYTES = 64 * 1024


def read_all(bytes_max: int, too_long: str) -> bytes:
    """Return standard input up to its end. Raises InvalidArgument with the text `too_long` beyond `bytes_max` bytes.

    Raises StampedeError after Ctrl-C, because the input is then incomplete.
    """
    read = bytearray()
    for piece in _pieces():
        read += piece
        if len(read) > bytes_max:
            raise InvalidArgument(too_long)
    if interruption.requested:
        raise StampedeError("Ctrl-C has ended the command before the end of its input")
    return bytes(read)


def read_lines() -> Iterator[bytes]:
    """Yield the lines of standard input without their newlines, up to its end or Ctrl-C.

    After Ctrl-C a line without its newline is incomplete, and is left out. Raises InvalidArgument for a line of more
    than PAYLOAD_BYTES_MAX bytes.
    """
    line = bytearray()
    for piece in _pieces():
        first, *others = piece.split(b"\n")
        line += first
        for one in others:
            yield _checked(line)
            line = bytearray(one)
        _checked(line)
    if line and not interruption.requested:
        yield _checked(line)


def _checked(line: bytearray) -> bytes:
    if len(line) > PAYLOAD_BYTES_MAX:
        raise InvalidArgument(f"a line has more than {PAYLOAD_BYTES_MAX} bytes, the greatest size of one item")
    return bytes(line)


def _pieces() -> Iterator[bytes]:
    if sys.stdin is None:
        raise InvalidArgument("standard input is closed, and the command reads it")
    file = sys.stdin.fileno()
    while not interruption.requested:
        if select.select([file], [], [], LOOK_S)[0]:
            piece = os.read(file, _READ_BYTES)
            if not piece:
                return
            yield piece
