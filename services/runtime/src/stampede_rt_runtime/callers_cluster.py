"""Refuses calls that name another cluster than this server's, before anything is done for them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import grpc

from stampede_rt.cluster.cluster_ids import told_cluster
from stampede_rt.errors import StampedeError
from stampede_rt.status import abort

# Why a caller of that cluster is not served; None: it is. Asked at each call that names a cluster.
JudgeCluster = Callable[[str], StampedeError | None]
# Whoever looks for its cluster must hear which one is here.
_OPEN_METHODS = frozenset({"/stampede_rt.v1.DirectoryService/Ping", "/grpc.health.v1.Health/Check"})


class ClusterInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[misc, unused-ignore]
    """A call that names no cluster passes, and so does one of the RPCs that tell who is here."""

    def __init__(self, judge: JudgeCluster) -> None:
        self._judge = judge

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The method's handler, or one that refuses."""
        told = told_cluster(handler_call_details.invocation_metadata)
        if told and handler_call_details.method not in _OPEN_METHODS:
            refusal = self._judge(told)
            if refusal is not None:
                return _refusing(refusal)
        return await continuation(handler_call_details)


def _refusing(refusal: StampedeError) -> Any:
    """Stream-stream on purpose: on the wire it serves every kind of call, and it answers before any request comes."""

    async def refuse(_requests: Any, context: grpc.aio.ServicerContext[Any, Any]) -> None:
        await abort(context, refusal)

    return grpc.stream_stream_rpc_method_handler(refuse)
