"""The standard health service (grpc.health.v1), which also serves callers without a credential."""

from __future__ import annotations

from typing import Any

import grpc
from grpc_health.v1 import health, health_pb2

from stampede_rt_runtime.rpc import Context

SERVICE = health.SERVICE_NAME
STATUS = health_pb2.HealthCheckResponse


class Health:
    """The health service for load balancers.

    `Check` is open to everybody. It reads no request, so that no caller can make it wait or buffer. It tells the state
    of the whole server, whichever service the caller names.
    """

    def __init__(self) -> None:
        self._known = health.aio.HealthServicer()
        self._status = STATUS.NOT_SERVING
        self._is_ending = False

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
        """Set the answer. After `end` it does not change any more."""
        if not self._is_ending:
            self._status = STATUS.SERVING if serving else STATUS.NOT_SERVING
            await self._known.set(health.OVERALL_HEALTH, self._status)

    async def end(self) -> None:
        """Answer NOT_SERVING from now on."""
        self._is_ending, self._status = True, STATUS.NOT_SERVING
        await self._known.enter_graceful_shutdown()

    async def _check(self, _requests: Any, _context: Context) -> health_pb2.HealthCheckResponse:
        return STATUS(status=self._status)
