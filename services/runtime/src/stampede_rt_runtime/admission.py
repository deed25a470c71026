"""Lets a call in by its caller's certificate: the right cluster, and a role that may call the RPC (see `roles`).

gRPC tells an interceptor nothing of the caller's certificate, only a running call: so each handler is wrapped.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc

from stampede_rt.errors import PermissionDenied
from stampede_rt.status import abort
from stampede_rt_runtime.identity import Identity, identity_among
from stampede_rt_runtime.roles import why_refused


def caller_identity(context: Any) -> Identity | None:
    """Who the call's certificate says the caller is; None without certificates, or if it names nobody."""
    found = context.auth_context().get("peer_uri", ())
    return identity_among(uri.decode(errors="replace") for uri in found)


class AdmissionInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """For a server that asks for certificates; `own` is the server's identity."""

    def __init__(self, own: Identity) -> None:
        self._own = own

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, which looks at the caller first."""
        handler = await continuation(handler_call_details)
        return None if handler is None else self._guarded(handler, handler_call_details.method)

    def _guarded(self, handler: Any, method: str) -> Any:
        make, behavior = _kind(handler)
        guard = self._guard_iterator if inspect.isasyncgenfunction(behavior) else self._guard_call
        return make(
            guard(behavior, method),
            request_deserializer=handler.request_deserializer,
            response_serializer=handler.response_serializer,
        )

    def _guard_call(self, behavior: Callable[..., Awaitable[Any]], method: str) -> Callable[..., Awaitable[Any]]:
        async def call(request: Any, context: Any) -> Any:
            await self._admit(method, context)
            return await behavior(request, context)

        return call

    def _guard_iterator(
        self, behavior: Callable[..., AsyncIterator[Any]], method: str
    ) -> Callable[..., AsyncIterator[Any]]:
        async def call(request: Any, context: Any) -> AsyncIterator[Any]:
            await self._admit(method, context)
            responses: Any = behavior(request, context)
            async with contextlib.aclosing(responses):
                async for response in responses:
                    yield response

        return call

    async def _admit(self, method: str, context: Any) -> None:
        caller = caller_identity(context)
        if caller is None:
            refusal = (
                "the caller's certificate names no one role of a cluster (one URI stampede://CLUSTER/ROLE/NAME); "
                "issue it with `stampede certs issue`"
            )
        else:
            refusal = why_refused(method, caller, self._own.cluster)
        if refusal:
            await abort(context, PermissionDenied(refusal))


def _kind(handler: Any) -> tuple[Callable[..., Any], Any]:
    """What makes a handler of this one's kind, and what it runs."""
    if handler.request_streaming:
        if handler.response_streaming:
            return grpc.stream_stream_rpc_method_handler, handler.stream_stream
        return grpc.stream_unary_rpc_method_handler, handler.stream_unary
    if handler.response_streaming:
        return grpc.unary_stream_rpc_method_handler, handler.unary_stream
    return grpc.unary_unary_rpc_method_handler, handler.unary_unary
