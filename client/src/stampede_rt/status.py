"""The table from errors to gRPC status codes, and the wire form of errors (`proto/stampede_rt/v1/error.proto`).

The module writes and reads `google.rpc.Status` and `google.rpc.ErrorInfo` field by field. The Python classes of
these messages are in another distribution, on which the base client should not depend.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, NoReturn

from google.protobuf.message import DecodeError

from stampede_rt.cluster.majority import UNREACHED
from stampede_rt.errors import DeadlineExceeded, PermissionDenied, StampedeError, Unavailable, error_for
from stampede_rt.grpc_quiet import grpc
from stampede_rt.v1 import error_pb2, rpc_status_pb2

DOMAIN = "stampede-rt"
DETAILS_KEY = "grpc-status-details-bin"
_ERROR_INFO_URL = "type.googleapis.com/google.rpc.ErrorInfo"
_PREFIX = "ERROR_REASON_"
_GRPC_PREAMBLE = re.compile(
    r"^failed to connect to all addresses; last error: [A-Z]+: [^ ]+: (Failed to connect to remote host: )?"
)
# The texts of gRPC for a broken connection, if its status code is not UNAVAILABLE. They come from grpc.aio after a
# failed write, from the core after a reset of the stream (INTERNAL for most codes, see doc/PROTOCOL-HTTP2.md of gRPC),
# and from older releases after a lost connection. If a service itself answers INTERNAL, its answer has an ErrorInfo. A
# defect in a service is UNKNOWN, with another text.
_BROKEN = re.compile(
    r"Internal error from Core$|(Received )?RST_STREAM|GOAWAY|Stream (removed|closed)|Socket closed|"
    r"(Client )?[Tt]ransport closed|Endpoint (closed|read failed)|(recvmsg|sendmsg):|Connection (reset|closed)"
)
_BROKEN_CODES = (grpc.StatusCode.INTERNAL, grpc.StatusCode.UNKNOWN)

_CODES: dict[str, grpc.StatusCode] = {
    "INVALID_ARGUMENT": grpc.StatusCode.INVALID_ARGUMENT,
    "INVALID_INTERVAL": grpc.StatusCode.INVALID_ARGUMENT,
    "AHEAD_OF_CLOCK": grpc.StatusCode.INVALID_ARGUMENT,
    "INVALID_NAME": grpc.StatusCode.INVALID_ARGUMENT,
    "MALFORMED_RUN": grpc.StatusCode.INVALID_ARGUMENT,
    "ITEM_TOO_LARGE": grpc.StatusCode.INVALID_ARGUMENT,
    "CHANNEL_NOT_FOUND": grpc.StatusCode.NOT_FOUND,
    "HOST_NOT_FOUND": grpc.StatusCode.NOT_FOUND,
    "GROUP_NOT_FOUND": grpc.StatusCode.NOT_FOUND,
    "QUEUE_NOT_FOUND": grpc.StatusCode.NOT_FOUND,
    "CHANNEL_EXISTS": grpc.StatusCode.ALREADY_EXISTS,
    "HOST_EXISTS": grpc.StatusCode.ALREADY_EXISTS,
    "GROUP_EXISTS": grpc.StatusCode.ALREADY_EXISTS,
    "QUEUE_EXISTS": grpc.StatusCode.ALREADY_EXISTS,
    "PEER_EXISTS": grpc.StatusCode.ALREADY_EXISTS,
    "NO_HOST": grpc.StatusCode.UNAVAILABLE,
    "CERTIFICATE_EXPIRED": grpc.StatusCode.UNAVAILABLE,
    "TOKEN_EXPIRED": grpc.StatusCode.UNAVAILABLE,
    "NOT_REPLICATED": grpc.StatusCode.UNAVAILABLE,
    "NOT_ARCHIVED": grpc.StatusCode.UNAVAILABLE,
    "NO_QUORUM": grpc.StatusCode.UNAVAILABLE,
    "AMBIGUOUS": grpc.StatusCode.UNAVAILABLE,
    "SHUTTING_DOWN": grpc.StatusCode.UNAVAILABLE,
    "WRONG_EPOCH": grpc.StatusCode.FAILED_PRECONDITION,
    "NOT_HERE": grpc.StatusCode.FAILED_PRECONDITION,
    "MOVED": grpc.StatusCode.FAILED_PRECONDITION,
    "TOO_OLD": grpc.StatusCode.FAILED_PRECONDITION,
    "IN_FUTURE": grpc.StatusCode.FAILED_PRECONDITION,
    "LEASE_EXPIRED": grpc.StatusCode.FAILED_PRECONDITION,
    "STALE_REGISTRATION": grpc.StatusCode.FAILED_PRECONDITION,
    "NOT_LEADER": grpc.StatusCode.FAILED_PRECONDITION,
    "WRONG_CLUSTER": grpc.StatusCode.FAILED_PRECONDITION,
    "VERSION_MISMATCH": grpc.StatusCode.FAILED_PRECONDITION,
    "CHANNEL_FULL": grpc.StatusCode.RESOURCE_EXHAUSTED,
    "OVERLOADED": grpc.StatusCode.RESOURCE_EXHAUSTED,
    "INCARNATION_LOST": grpc.StatusCode.DATA_LOSS,
    "UNAUTHENTICATED": grpc.StatusCode.UNAUTHENTICATED,
    "PERMISSION_DENIED": grpc.StatusCode.PERMISSION_DENIED,
    "WATCH_RESTART": grpc.StatusCode.OUT_OF_RANGE,
    "DEADLINE_EXCEEDED": grpc.StatusCode.DEADLINE_EXCEEDED,
    "PEER_NOT_FOUND": grpc.StatusCode.NOT_FOUND,
    "QUEUE_FULL": grpc.StatusCode.RESOURCE_EXHAUSTED,
    "MOVE_NOT_FOUND": grpc.StatusCode.NOT_FOUND,
    "MOVE_CONFLICT": grpc.StatusCode.FAILED_PRECONDITION,
    "INTERNAL": grpc.StatusCode.INTERNAL,
}


def code_for(reason: str) -> grpc.StatusCode:
    """Return the gRPC status code of a reason; INTERNAL for an unknown reason."""
    return _CODES.get(reason, grpc.StatusCode.INTERNAL)


def encode_status(error: StampedeError) -> bytes:
    """Return `error` as an encoded google.rpc.Status with one ErrorInfo."""
    info = rpc_status_pb2.ErrorInfo(reason=error.reason, domain=DOMAIN, metadata=error.metadata)
    number, _ = code_for(error.reason).value
    status = rpc_status_pb2.Status(code=number, message=error.message)
    status.details.add(type_url=_ERROR_INFO_URL, value=info.SerializeToString())
    return status.SerializeToString()


async def abort(context: Any, error: StampedeError) -> NoReturn:
    """End an RPC of a grpc.aio server with `error`. Never returns."""
    await context.abort(code_for(error.reason), error.message, ((DETAILS_KEY, encode_status(error)),))
    raise AssertionError("abort returned")


def to_error_message(error: StampedeError) -> error_pb2.Error:
    """Return `error` in the form that messages of a stream carry."""
    return error_pb2.Error(reason=_PREFIX + error.reason, message=error.message, metadata=error.metadata)


def from_error_message(message: error_pb2.Error) -> StampedeError:
    """Return the exception for an Error inside a stream."""
    try:
        reason = error_pb2.ErrorReason.Name(message.reason).removeprefix(_PREFIX)
    except ValueError:  # the server is newer, and this release does not know the reason
        reason = "INTERNAL"
    return error_for(reason, message.message, dict(message.metadata))


def from_rpc_error(error: grpc.RpcError, peer: str) -> StampedeError:
    """Return the exception for a failed RPC to `peer` (an address, for the message)."""
    found = error_in(_trailers(error))
    if found is None:
        return _from_code(error, peer)
    found.from_service = True
    return found


def raise_from_rpc_error(error: grpc.RpcError, peer: str) -> NoReturn:
    """Raise the exception of `from_rpc_error`.

    gRPC's error is its cause only if no service answered. Otherwise a traceback would show the same text twice.
    """
    found = from_rpc_error(error, peer)
    raise found from (None if found.from_service else error)


def error_in(trailers: Iterable[tuple[str, str | bytes]] | None) -> StampedeError | None:
    """Return the exception in a call's trailing metadata; None if the server did not end the call with `abort`."""
    for key, value in trailers or ():
        if key == DETAILS_KEY and isinstance(value, bytes):
            found = _from_status(value)
            if found is not None:
                return found
    return None


def _trailers(error: grpc.RpcError) -> Iterable[tuple[str, str | bytes]]:
    trailers: Any = error.trailing_metadata() if hasattr(error, "trailing_metadata") else None
    return [(key, value) for key, value in trailers or ()]


def _from_status(encoded: bytes) -> StampedeError | None:
    try:
        status = rpc_status_pb2.Status.FromString(encoded)
        found = next((one for one in status.details if one.type_url == _ERROR_INFO_URL), None)
        info = None if found is None else rpc_status_pb2.ErrorInfo.FromString(found.value)
    except DecodeError:  # then only the status code explains the failure
        return None
    return None if info is None else error_for(info.reason, status.message, dict(info.metadata))


def _brief(details: str) -> str:
    """Return gRPC's text of an error without the general words at its beginning."""
    return _GRPC_PREAMBLE.sub("", details)


def _from_code(error: grpc.RpcError, peer: str) -> StampedeError:
    code = error.code() if hasattr(error, "code") else grpc.StatusCode.UNKNOWN
    details = _brief((error.details() if hasattr(error, "details") else None) or "no details")
    if code in _BROKEN_CODES and _BROKEN.match(details):
        return Unavailable(f"the connection to {peer} broke ({details})")
    if code is grpc.StatusCode.UNAVAILABLE:
        text = f"{peer} cannot be reached ({details}); is it running, and is the address right?"
        return Unavailable(text, metadata={UNREACHED: details})
    if code is grpc.StatusCode.DEADLINE_EXCEEDED:
        return DeadlineExceeded(f"{peer} did not answer in time; it may be overloaded or stopped")
    if code in (grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED):
        return PermissionDenied(f"{peer} refused this caller: {details}")
    if code is grpc.StatusCode.CANCELLED:
        return Unavailable(f"the call to {peer} was cancelled: {details}")
    if code is grpc.StatusCode.RESOURCE_EXHAUSTED:
        return error_for("OVERLOADED", f"{peer} refused the call: {details}; send less at a time, or try later")
    return StampedeError(f"{peer} failed with {code.name}: {details}")
