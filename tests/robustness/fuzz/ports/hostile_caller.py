"""Calls RPCs of one port with random requests, with and without a credential, and checks each answer."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Sequence
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.messages import KnownValues, drawn_request, drawn_stream
from tests.robustness.fuzz.ports.methods import Method
from tests.robustness.fuzz.ports.outcome import BROKEN, Finding, Outcome
from tests.robustness.fuzz.ports.socket_calls import SocketPort, called_over_socket

DRAWN_BYTES = 1500
STREAM_SECONDS = 0.05
CALL_SECONDS = 20.0  # even a busy machine answers within this time
ANSWERS_MAX = 20
LEARNT_PERCENT = 25
# Calls that may wait until their deadline. The caller ends them after STREAM_SECONDS.
WAITING = ("/GetCut", "/AddSupernode", "/RemoveSupernode", "/TakeSnapshot")
WRITTEN_TOO_LATE = "Internal error from Core"  # the error of this side's gRPC if a call ended before a request was sent

Metadata = tuple[tuple[str, str], ...]


class HostileCaller:
    """Makes one call after the other. Later calls use the values of earlier answers."""

    def __init__(
        self, methods: Sequence[Method], known: KnownValues, credential: Metadata, outcome: Outcome, *, seed: str
    ) -> None:
        self._methods = [method for method in methods for _ in range(method.weight)]
        self._known = known
        self._credential = credential
        self._outcome = outcome
        self._random_source = random.Random(seed)
        self.socket: SocketPort | None = None
        """The socket of the port; None: the port has no socket."""

    async def play(self, channel: grpc.aio.Channel) -> None:
        """Make one call."""
        source = ByteSource(self._random_source.randbytes(DRAWN_BYTES))
        method = source.choice(self._methods)
        metadata = self._metadata(source)
        requests = self._requests(source, method)
        if self.socket is not None and method.takes_stream and source.chance(self.socket.percent):
            call = called_over_socket(self.socket, method.path, requests, metadata, source, STREAM_SECONDS)
            code, details = await call
        else:
            learns = source.chance(LEARNT_PERCENT)
            code, details = await self._called(channel, method, requests, metadata, learns=learns)
        self._outcome.calls += 1
        self._outcome.inputs += len(requests)
        self._outcome.codes[code.name] += 1
        self._outcome.by_method[f"{method.path.rpartition('.')[2]} {code.name}"] += 1
        if code in BROKEN and details != WRITTEN_TOO_LATE:
            self._found(f"{code.name}: {details}", method, requests)

    def _requests(self, source: ByteSource, method: Method) -> list[bytes]:
        if method.takes_stream:
            return drawn_stream(source, method.request, self._known, 1 + source.below(8))
        return [drawn_request(source, method.request, self._known)]

    def _metadata(self, source: ByteSource) -> Metadata:
        """Mostly the right credential; none, or a strange one, in some calls."""
        kind = source.below(20)
        if kind < 18:
            return self._credential
        strange = hostile_values.text(source).encode("ascii", "ignore").decode()
        value = "".join(character for character in strange if character.isprintable())[:200].strip()
        return () if kind == 18 else (("authorization", value), ("x-hostile-bin", bytes(value, "ascii")))  # type: ignore[arg-type,return-value]

    async def _called(
        self, channel: grpc.aio.Channel, method: Method, requests: Sequence[bytes], metadata: Metadata, *, learns: bool
    ) -> tuple[grpc.StatusCode, str]:
        waits = method.may_stay_open or method.path.endswith(WAITING)
        call = _begun(channel, method, requests, metadata)
        try:
            async with asyncio.timeout(STREAM_SECONDS if waits else None):
                if method.takes_stream:
                    for request in requests:
                        await call.write(request)
                    await call.done_writing()
                await self._read(call, method, learns)
                return grpc.StatusCode.OK, ""
        except TimeoutError:
            return grpc.StatusCode.CANCELLED, "by the caller"
        except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
            code, details = await call.code(), await call.details()
            if code == grpc.StatusCode.DEADLINE_EXCEEDED and not waits:
                self._found(f"no answer within {CALL_SECONDS:g} s: {details}", method, requests)
            return code, details
        finally:
            call.cancel()

    async def _read(self, call: Any, method: Method, learns: bool) -> None:
        for _ in range(ANSWERS_MAX if method.may_stay_open else 1):
            raw = await (call.read() if method.may_stay_open else call)
            if raw is grpc.aio.EOF:
                return
            if learns:
                try:
                    self._known.learn(method.response.FromString(raw))  # type: ignore[attr-defined]
                except DecodeError:
                    self._found("an answer that its message type cannot decode", method, ())

    def _found(self, what: str, method: Method, requests: Sequence[bytes]) -> None:
        self._outcome.add(Finding(what=what, method=method.path, requests=tuple(raw.hex() for raw in requests)))


def _begun(channel: grpc.aio.Channel, method: Method, requests: Sequence[bytes], metadata: Metadata) -> Any:
    """Begin the call. If the method takes a stream, the caller must still send the requests."""
    if method.takes_stream:
        return channel.stream_stream(method.path)(metadata=metadata, timeout=CALL_SECONDS)
    kind = channel.unary_stream if method.answers_stream else channel.unary_unary
    return kind(method.path)(requests[0], metadata=metadata, timeout=CALL_SECONDS)
