"""The error of a failed call names its cause."""

from __future__ import annotations

import traceback

import grpc
import grpc.aio
import pytest

import stampede_rt as st
from stampede_rt.status import DETAILS_KEY, encode_status, from_rpc_error, raise_from_rpc_error

INTERNAL, UNKNOWN = grpc.StatusCode.INTERNAL, grpc.StatusCode.UNKNOWN


def failed(code: grpc.StatusCode, details: str, error: st.StampedeError | None = None) -> grpc.aio.AioRpcError:
    trailers = grpc.aio.Metadata(*([(DETAILS_KEY, encode_status(error))] if error else []))
    return grpc.aio.AioRpcError(code, grpc.aio.Metadata(), trailers, details=details)


@pytest.mark.parametrize(
    ("code", "details"),
    [
        (INTERNAL, "Internal error from Core"),
        (INTERNAL, "Received RST_STREAM with error code 2"),
        (INTERNAL, "Received RST_STREAM with error code 0"),
        (UNKNOWN, "Stream removed"),
        (UNKNOWN, "Stream removed (recvmsg:Connection reset by peer (104))"),
        (grpc.StatusCode.UNAVAILABLE, "Stream removed (Socket closed)"),
        (grpc.StatusCode.UNAVAILABLE, "GOAWAY received"),
        (grpc.StatusCode.CANCELLED, "Received RST_STREAM with error code 8"),
    ],
)
def test_a_connection_that_broke_is_reported_as_unavailable(code: grpc.StatusCode, details: str) -> None:
    error = from_rpc_error(failed(code, details), "h:1")
    assert isinstance(error, st.Unavailable)
    assert error.retryable
    assert "h:1" in str(error)


@pytest.mark.parametrize(
    "error",
    [
        failed(INTERNAL, "Internal error from Core", st.StampedeError("the store is broken")),
        failed(UNKNOWN, "Unexpected <class 'KeyError'>: 'x'"),
        failed(INTERNAL, "Failed to serialize response!"),
    ],
)
def test_a_defect_of_the_service_is_not_retryable(error: grpc.aio.AioRpcError) -> None:
    decoded = from_rpc_error(error, "h:1")
    assert type(decoded) is st.StampedeError
    assert not decoded.retryable


def test_the_error_of_a_service_has_no_traceback_of_grpc() -> None:
    refused = failed(grpc.StatusCode.PERMISSION_DENIED, "no", st.PermissionDenied("rule 3 denies it"))
    broken = failed(UNKNOWN, "Unexpected <class 'KeyError'>: 'x'")
    shown = {}
    for error in (refused, broken):
        try:
            try:
                raise error
            except grpc.RpcError as caught:
                raise_from_rpc_error(caught, "h:1")
        except st.StampedeError as raised:
            shown[error] = raised.from_service, "AioRpcError" in "".join(traceback.format_exception(raised))
    assert shown == {refused: (True, False), broken: (False, True)}
