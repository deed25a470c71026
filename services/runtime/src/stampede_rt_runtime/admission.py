"""Lets a call in by its caller's certificate: the right cluster, and a role that may call the RPC (see `roles`)."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import grpc

from stampede_rt.errors import PermissionDenied
from stampede_rt.status import abort
from stampede_rt_runtime.handlers import guarded
from stampede_rt_runtime.identity import Identity, identity_among
from stampede_rt_runtime.roles import why_refused
from stampede_rt_runtime.rpc import Context


def caller_identity(context: Context) -> Identity | None:
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
        if handler is None:
            return None
        method = handler_call_details.method

        @contextlib.asynccontextmanager
        async def admitted(context: Context) -> AsyncIterator[None]:
            await self._admit(method, context)
            yield

        return guarded(handler, admitted)

    async def _admit(self, method: str, context: Context) -> None:
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
