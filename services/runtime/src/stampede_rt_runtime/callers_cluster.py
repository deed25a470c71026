"""Refuses calls that name another cluster than this server's, before their methods run."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import grpc

from stampede_rt.cluster.cluster_ids import named_cluster
from stampede_rt.errors import StampedeError
from stampede_rt.status import abort

# Takes the id of a caller's cluster. Returns the error for the caller; None: the server serves the call.
JudgeCluster = Callable[[str], StampedeError | None]
# Callers use these methods to find the cluster of a server.
_OPEN_METHODS = frozenset({"/stampede_rt.v1.DirectoryService/Ping", "/grpc.health.v1.Health/Check"})


class ClusterInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """Refuses calls that name another cluster.

    Calls that name no cluster pass. Calls of the methods that return the server's cluster also pass.
    """

    def __init__(self, judge: JudgeCluster) -> None:
        self._judge = judge

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, or a handler that refuses the call."""
        named = named_cluster(handler_call_details.invocation_metadata)
        if named and handler_call_details.method not in _OPEN_METHODS:
            refusal = self._judge(named)
            if refusal is not None:
                return _refusing(refusal)
        return await continuation(handler_call_details)


def _refusing(refusal: StampedeError) -> Any:
    """A handler that refuses the call.

    It is a stream-stream handler, because such a handler serves every kind of call on the wire. It answers before any
    request comes.
    """

    async def refuse(_requests: Any, context: grpc.aio.ServicerContext[Any, Any]) -> None:
        await abort(context, refusal)

    return grpc.stream_stream_rpc_method_handler(refuse)
