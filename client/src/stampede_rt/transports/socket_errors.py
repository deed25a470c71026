"""The errors of streams over sockets, in the form of gRPC's errors."""

from __future__ import annotations

from typing import Any

from google.protobuf.message import DecodeError

from stampede_rt.grpc_quiet import grpc
from stampede_rt.status import DETAILS_KEY
from stampede_rt.v1 import rpc_status_pb2

_CODES = {code.value[0]: code for code in grpc.StatusCode}


class SocketError(grpc.RpcError):  # type: ignore[misc, unused-ignore]
    """The end of a stream over a socket with an error."""

    def __init__(self, code: grpc.StatusCode, details: str, encoded: bytes = b"") -> None:
        """`encoded`: the google.rpc.Status of the service; empty: no service answered."""
        super().__init__(details)
        self._code, self._details, self._encoded = code, details, encoded

    def code(self) -> grpc.StatusCode:
        """Return the status code."""
        return self._code

    def details(self) -> str:
        """Return the text for people."""
        return self._details

    def without_frames(self) -> SocketError:
        """Return the same error without stack frames. A stream that keeps an error raises this copy.

        Otherwise the traceback of the error would reference the stack frames of the code that reads the stream, and
        these frames would reference the stream.
        """
        return SocketError(self._code, self._details, self._encoded)

    def trailing_metadata(self) -> Any:
        """Return the status of the service, as gRPC's trailing metadata have it."""
        return ((DETAILS_KEY, self._encoded),) if self._encoded else ()


def error_of(status: bytes | memoryview) -> SocketError | None:
    """Return the error for the body of a status frame; None for the regular end."""
    try:
        found = rpc_status_pb2.Status.FromString(bytes(status))
    except DecodeError:
        return SocketError(grpc.StatusCode.UNKNOWN, "the last frame holds no status")
    if not found.code:
        return None
    return SocketError(_CODES.get(found.code, grpc.StatusCode.UNKNOWN), found.message, bytes(status))


def broken(why: str) -> SocketError:
    """Return the error of a stream whose connection was lost."""
    return SocketError(grpc.StatusCode.INTERNAL, f"Socket closed: {why}")


def silent(silence_s: float) -> SocketError:
    """Return the error of a stream on which nothing came for too long."""
    return SocketError(grpc.StatusCode.UNAVAILABLE, f"no sign of life for {silence_s:g} s")


def cancelled() -> SocketError:
    """Return the error of a stream that this side has cancelled."""
    return SocketError(grpc.StatusCode.CANCELLED, "Locally cancelled")
