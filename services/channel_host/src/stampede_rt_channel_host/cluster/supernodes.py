"""The way to the directory. Front-ends name the supernodes. The host asks one supernode, and if that one fails, the
next.
"""

from __future__ import annotations

import asyncio
import logging
import random
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Sequence
from typing import Any, NamedTuple

import grpc

from stampede_rt.cluster.directory_call import (
    SUPERNODES_MAX,
    DirectoryCall,
    check_frontend,
    frontend_timeout_s,
    may_pass,
)
from stampede_rt.cluster.request_age import age_clock_s, age_metadata
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.pacing.retry import Backoff
from stampede_rt.status import from_rpc_error
from stampede_rt.transports.streams_async import closed, is_cancelled
from stampede_rt.v1 import directory_service_pb2_grpc, frontend_service_pb2, frontend_service_pb2_grpc
from stampede_rt_runtime.version import PROTOCOL_VERSION, software_version

logger = logging.getLogger(__name__)

TRY_SECONDS_MAX = 1.5  # for one supernode, so that a hanging one does not use up the whole time
BIND_SECONDS_MAX = 3.0  # for one front-end

Dial = Callable[[str], grpc.aio.Channel]
Explain = Callable[[str], Awaitable[StampedeError | None]]
Service = Callable[[grpc.aio.Channel], Any]


class _Call(NamedTuple):
    """A call that the host may repeat at several supernodes. `service` makes the stub that has the method.

    `since_s`: when the host made this call, or the first call with the same request id, by `age_clock_s`.
    `final_reason`: an error with this reason ends the call, although a later try may succeed.
    """

    method: str
    request: Any
    service: Service
    since_s: float
    final_reason: str | None


class Supernodes:
    """Calls the directory. First asks the supernode that answered last, or, right after a `bind`, the leader.

    `explain` may give a better reason than gRPC for a failed connection to a front-end.
    """

    def __init__(
        self, frontends: Sequence[str], dial: Dial, *, peer_name: str, zone: str = "", explain: Explain | None = None
    ) -> None:
        self._frontends = tuple(frontends)
        self._dial = dial
        self._peer_name = peer_name
        self._zone = zone
        self._explain = explain
        self._targets: list[str] = []
        self._channels: dict[str, grpc.aio.Channel] = {}
        self._broken_streams = 0
        self.cluster_id = ""  # as the front-ends name it; empty before the first answer

    async def call(
        self,
        method: str,
        request: Any,
        timeout_s: float,
        *,
        service: Service = directory_service_pb2_grpc.DirectoryServiceStub,
        since_s: float | None = None,
        final_reason: str | None = None,
    ) -> Any:
        """Make one call of `service`. Tries all known supernodes. If all fail, asks the front-ends, and tries again.

        Updates carry a request id and the age of the request, so it is safe to repeat them. The age counts from now, or
        from `since_s` by `age_clock_s`. Raises the error with which the directory answers, or the last failure as soon
        as `timeout_s` is over. Raises an error with the reason `final_reason` immediately, without another try.
        """
        backoff = Backoff(time.monotonic() + timeout_s)
        call = _Call(method, request, service, age_clock_s() if since_s is None else since_s, final_reason)
        rounds = DirectoryCall(backoff.deadline_s)
        while True:  # the backoff's deadline ends it
            try:
                if not self._targets:
                    await self.bind(backoff.deadline_s)
                return await self._call_each(call, rounds)
            except StampedeError as error:
                if not may_pass(error) or error.reason == final_reason:
                    raise
                delay_s = backoff.next_delay_s(time.monotonic(), random.random())
                if delay_s is None:
                    raise
                logger.debug(
                    "directory call failed",
                    extra={"event": "directory_call_failed", "method": method, "why": str(error)},
                )
            await asyncio.sleep(delay_s)
            await self._rebind(backoff.deadline_s)

    async def stream(self, method: str, request: Any) -> AsyncGenerator[Any, None]:
        """Yield the responses of a streaming call of DirectoryService. After a failure, the next stream goes to another
        supernode.

        Raises the error that ended the stream, or Unavailable. Close the iterator to end the call.
        """
        if not self._targets:
            await self.bind(time.monotonic() + BIND_SECONDS_MAX)
        if not self._targets:
            raise Unavailable("the front-ends name no supernode")
        # The first stream goes not to the leader, if there are others: the leader has more work.
        target = self._targets[-1 - self._broken_streams % len(self._targets)]
        call = getattr(directory_service_pb2_grpc.DirectoryServiceStub(self._channel(target)), method)(request)
        try:
            async for response in call:
                yield response
        except asyncio.CancelledError:
            if is_cancelled():
                raise
            raise closed(target) from None
        except grpc.RpcError as error:
            self._broken_streams += 1
            raise from_rpc_error(error, target) from error
        finally:
            call.cancel()

    def known(self) -> tuple[str, ...]:
        """The addresses of the supernodes, in the order in which the host asks them. Any thread may call this."""
        return tuple(self._targets)

    def learn(self, targets: Sequence[str]) -> None:
        """Take over the addresses that another part of the host has found. Does nothing if some are known already."""
        if not self._targets:
            self._targets = list(targets)

    async def bind(self, deadline_s: float) -> None:
        """Ask the front-ends, one after the other, for the supernodes.

        Raises Unavailable if none answers, or an error that a repetition cannot cure, such as VersionMismatch.
        """
        failure: StampedeError = Unavailable("no front-end answered in time")
        for position, target in enumerate(self._frontends):
            timeout_s = frontend_timeout_s(deadline_s - time.monotonic(), len(self._frontends) - position)
            try:
                response = await self._ask_frontend(target, min(timeout_s, BIND_SECONDS_MAX))
            except StampedeError as error:
                if not may_pass(error):
                    raise
                failure = await self._explained(target, error)
                continue
            await self._learn(response)
            return
        if not may_pass(failure):
            raise failure
        raise Unavailable(f"cannot learn the supernodes from {', '.join(self._frontends)}: {failure}")

    async def _explained(self, target: str, error: StampedeError) -> StampedeError:
        if self._explain is None or not isinstance(error, Unavailable):
            return error
        return await self._explain(target) or error

    async def _ask_frontend(self, target: str, timeout_s: float) -> frontend_service_pb2.BindResponse:
        request = frontend_service_pb2.BindRequest(
            peer_name=self._peer_name,
            zone=self._zone,
            protocol_version=PROTOCOL_VERSION,
            version=software_version(),
        )
        stub = frontend_service_pb2_grpc.FrontendServiceStub(self._channel(target))
        response: frontend_service_pb2.BindResponse = await _call(stub.Bind, request, timeout_s, target)
        spoken = response.protocol_version
        check_frontend(target, spoken, response.version, caller="host", caller_version=software_version())
        return response

    async def _learn(self, response: frontend_service_pb2.BindResponse) -> None:
        """Take over the supernodes, the leader first.

        Only the leader can answer all requests without asking another.
        """
        ranked = sorted(response.supernodes, key=lambda one: not (one.is_leader and one.healthy))
        self._targets = [one.endpoint.target for one in ranked if one.endpoint.target][:SUPERNODES_MAX]
        self.cluster_id = response.cluster_id
        known = {*self._targets, *self._frontends}
        for target in [one for one in self._channels if one not in known]:
            await self._channels.pop(target).close(None)

    async def _rebind(self, deadline_s: float) -> None:
        """Ask the front-ends for other supernodes, because all known ones failed.

        Keeps the known supernodes if no front-end answers.
        """
        try:
            await self.bind(deadline_s)
        except StampedeError as error:
            if not may_pass(error):
                raise
            logger.debug("no front-end answers", extra={"event": "no_frontend", "why": str(error)})

    async def _call_each(self, call: _Call, rounds: DirectoryCall) -> Any:
        rounds.begin_round(self._targets, TRY_SECONDS_MAX)
        while (attempt := rounds.next_attempt(time.monotonic())) is not None:
            try:
                answer = await self._call_one(attempt.target, call, attempt.timeout_s)
            except StampedeError as error:
                if error.reason == call.final_reason:
                    raise
                rounds.note_failure(attempt.target, error)
                continue
            self._prefer(attempt.target)
            return answer
        raise rounds.failure(self._targets)

    async def _call_one(self, target: str, call: _Call, timeout_s: float) -> Any:
        stub = call.service(self._channel(target))
        metadata = age_metadata(age_clock_s() - call.since_s)
        return await _call(getattr(stub, call.method), call.request, timeout_s, target, metadata)

    def _prefer(self, target: str) -> None:
        if self._targets[:1] != [target]:
            self._targets = [target, *(one for one in self._targets if one != target)][:SUPERNODES_MAX]

    def _channel(self, target: str) -> grpc.aio.Channel:
        if target not in self._channels:
            self._channels[target] = self._dial(target)
        return self._channels[target]

    async def aclose(self) -> None:
        """Close all connections to supernodes and front-ends."""
        channels, self._channels = list(self._channels.values()), {}
        for channel in channels:
            await channel.close(None)


def is_unknown_call(error: StampedeError) -> bool:
    """Whether the supernode that answered is of an earlier release, which does not know the call."""
    cause = error.__cause__
    return isinstance(cause, grpc.aio.AioRpcError) and cause.code() is grpc.StatusCode.UNIMPLEMENTED


async def _call(
    method: Callable[..., Any], request: Any, timeout_s: float, target: str, metadata: Sequence[tuple[str, str]] = ()
) -> Any:
    try:
        return await method(request, timeout=timeout_s, metadata=metadata)
    except asyncio.CancelledError:
        if is_cancelled():
            raise
        raise closed(target) from None  # another call has closed this connection, see `_learn`
    except grpc.RpcError as error:
        raise from_rpc_error(error, target) from error
