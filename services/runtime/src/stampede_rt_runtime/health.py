"""The standard health service (grpc.health.v1), which also serves callers without a credential."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
from google.protobuf.message import DecodeError
from grpc_health.v1 import health, health_pb2

from stampede_rt_runtime.rpc import Context

SERVICE = health.SERVICE_NAME
STATUS = health_pb2.HealthCheckResponse
LIVENESS, READINESS = "liveness", "readiness"
"""The names that a caller may give: whether the process answers at all, and whether it can serve its callers now."""
READ_SECONDS_MAX = 1.0
READS_MAX = 8
"""The most requests that `Check` reads at the same time. Any caller may call it, and each request may be large."""


class Health:
    """The health service for load balancers and supervisors.

    For `Check` any other name than LIVENESS means READINESS, and so does a missing name. `Check` is open to all
    callers, so it reads few requests at a time, and for a short time. A caller that sends no request in time, or that
    must make room for newer callers, gets the answer for READINESS.
    """

    def __init__(self) -> None:
        self._known = health.aio.HealthServicer()
        self._status = STATUS.NOT_SERVING
        self._is_ending = False
        self._reading: dict[asyncio.Timeout, None] = {}

    def add_to(self, server: grpc.aio.Server) -> None:
        """Serve on `server`."""
        serializer = STATUS.SerializeToString
        handlers: dict[str, grpc.RpcMethodHandler[Any, Any]] = {
            "Check": grpc.stream_unary_rpc_method_handler(self._check, response_serializer=serializer),
            "Watch": grpc.unary_stream_rpc_method_handler(
                self._known.Watch,
                request_deserializer=health_pb2.HealthCheckRequest.FromString,
                response_serializer=serializer,
            ),
        }
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(SERVICE, handlers),))

    @property
    def is_serving(self) -> bool:
        """Whether the service is ready."""
        return bool(self._status == STATUS.SERVING)

    async def set_serving(self, serving: bool) -> None:
        """Set the answer for READINESS. After `end` it does not change any more."""
        if not self._is_ending:
            self._status = STATUS.SERVING if serving else STATUS.NOT_SERVING
            await self._known.set(LIVENESS, STATUS.SERVING)
            for name in (health.OVERALL_HEALTH, READINESS):
                await self._known.set(name, self._status)

    async def end(self) -> None:
        """Answer NOT_SERVING from now on. `Check` still says that the process lives."""
        self._is_ending, self._status = True, STATUS.NOT_SERVING
        await self._known.enter_graceful_shutdown()

    async def _check(self, requests: AsyncIterator[bytes], _context: Context) -> health_pb2.HealthCheckResponse:
        name = await self._name_in(requests)
        return STATUS(status=STATUS.SERVING if name == LIVENESS else self._status)

    async def _name_in(self, requests: AsyncIterator[bytes]) -> str:
        """The name in the first request; empty if there is none in time."""
        if len(self._reading) >= READS_MAX:
            oldest = next(iter(self._reading))
            del self._reading[oldest]
            oldest.reschedule(0)  # a time in the past: it ends now
        try:
            async with asyncio.timeout(READ_SECONDS_MAX) as limit:
                self._reading[limit] = None
                try:
                    raw = await anext(requests, b"")
                finally:
                    self._reading.pop(limit, None)
            return str(health_pb2.HealthCheckRequest.FromString(raw).service)
        except (TimeoutError, DecodeError):
            return ""
