"""OpenTelemetry spans of the RPCs that a service serves, if an SDK was configured before the service began."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc

from stampede_rt.cluster.tracing import TRACER, trace_api
from stampede_rt_runtime.handlers import guarded
from stampede_rt_runtime.health import SERVICE as HEALTH
from stampede_rt_runtime.roles import PACKAGE, is_closed_to_clients
from stampede_rt_runtime.rpc import Context

# Many calls share one stream of these methods, so the stream's span would belong to none of them.
_SHARED = frozenset(
    f"/{PACKAGE}.{name}" for name in ("ChannelService/Put", "ChannelService/Get", "QueueService/Enqueue")
)
_PERIODIC = frozenset(
    f"/{PACKAGE}.{name}"
    for name in ("DirectoryService/Ping", "DirectoryService/ListSupernodes", "GatekeeperService/Ping")
)


def is_traced(method: str) -> bool:
    """Whether calls of the method have spans. Calls between services, checks of health and shared streams have none."""
    without = method in _SHARED or method in _PERIODIC or is_closed_to_clients(method)
    return not without and not method.startswith(f"/{HEALTH}/")


def tracing_interceptors() -> list[grpc.aio.ServerInterceptor]:
    """An interceptor that makes the spans; none if no SDK is configured."""
    return [] if trace_api() is None else [TracingInterceptor()]


class TracingInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Makes a span for each call, as a child of the caller's span.

    The server runs the interceptors that check the caller before this one.
    """

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, which begins a span first."""
        handler = await continuation(handler_call_details)
        trace = trace_api()
        if handler is None or trace is None or not is_traced(handler_call_details.method):
            return handler
        method, metadata = handler_call_details.method, handler_call_details.invocation_metadata

        @contextlib.asynccontextmanager
        async def spanned(_context: Context) -> AsyncIterator[None]:
            from opentelemetry import propagate  # not at the top: a service without an SDK does not load it

            texts = {key: value for key, value in metadata or () if isinstance(value, str)}
            service, _, name = method.strip("/").partition("/")
            attributes = {"rpc.system": "grpc", "rpc.service": service, "rpc.method": name}
            tracer = trace.get_tracer(TRACER)
            with tracer.start_as_current_span(
                method.strip("/"), context=propagate.extract(texts), kind=trace.SpanKind.SERVER, attributes=attributes
            ):
                yield

        return guarded(handler, spanned)
