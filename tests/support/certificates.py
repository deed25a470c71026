"""Calls with a certificate of the caller's choice."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import from_rpc_error
from stampede_rt_runtime.dial import dial

SENDING_STILL = "Internal error from Core"  # grpc.aio's own text


def ask(address: str, files: st.TlsFiles | None, call: Callable[[Any], Any]) -> str:
    """Make a call with this certificate. Returns the service's error text; empty if the call succeeded.

    Makes the call again if the service refused a stream while grpc.aio still sent a request. Then grpc.aio loses the
    answer.
    """

    async def error_text() -> str:
        assert files is not None
        async with dial(address, secret=None, tls=TlsReader(files)) as channel:
            while True:  # ends with the test's timeout
                try:
                    await call(channel)
                except grpc.aio.AioRpcError as error:
                    if error.details() != SENDING_STILL:
                        return f"{error.code().name}: {from_rpc_error(error, 'it').message}"
                else:
                    return ""

    return asyncio.run(error_text())
