"""The stream in which a drain asks one host to take over channels (`MigrationService.MoveEachHere`)."""

from __future__ import annotations

import asyncio
from itertools import islice
from typing import Any

import grpc

from stampede_rt.errors import DeadlineExceeded, StampedeError, Unavailable
from stampede_rt.status import from_error_message, from_rpc_error
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.moves.moves_of_drains import NAMED_MAX

METHOD = "/stampede_rt.v1.MigrationService/MoveEachHere"


class DrainRequests:
    """The requests to one host. The requests of one turn of the event loop go into one message, NAMED_MAX at most."""

    def __init__(self, target: str, channel: grpc.aio.Channel) -> None:
        """`channel`: the connection to the host at `target`."""
        self._target = target
        self._channel = channel
        self._answers: dict[bytes, asyncio.Future[None]] = {}  # by channel: its request's answer, which has not come
        self._new: dict[bytes, None] = {}  # the channels that no message names yet
        self._wakeup = asyncio.Event()
        self._stream: asyncio.Task[None] | None = None
        self._is_supported = True  # whether the host knows the method, as far as this object knows

    async def take(self, channel_id: bytes, seconds: float) -> bool:
        """Have the host take a channel over. False: the host is of an older release, and does not know this request.

        Raises the error of the move, DeadlineExceeded after `seconds`, and Unavailable if the stream breaks.
        """
        if not self._is_supported:
            return False
        answer = self._answers[channel_id] = asyncio.get_running_loop().create_future()
        self._new[channel_id] = None
        self._wakeup.set()
        if self._stream is None:
            self._stream = asyncio.create_task(self._run(), name=f"drain to {self._target}")
        try:
            async with asyncio.timeout(seconds):
                await answer
        except TimeoutError:
            raise DeadlineExceeded(f"{self._target} did not answer in {seconds:g} s") from None
        except StampedeError:
            if self._is_supported:
                raise
        finally:
            if self._answers.get(channel_id) is answer:
                del self._answers[channel_id]
                self._new.pop(channel_id, None)  # the caller may ask another host next
        return self._is_supported

    async def _run(self) -> None:
        """Ask, and deliver the outcomes, until the stream breaks. Then all requests without an answer fail."""
        failure: StampedeError = Unavailable(f"{self._target} has ended the stream of the drain")
        call = self._channel.stream_stream(
            METHOD,
            request_serializer=pb.MoveEachHereRequest.SerializeToString,
            response_deserializer=pb.MoveEachHereResponse.FromString,
        )()
        writing = asyncio.create_task(self._write(call))
        try:
            while isinstance(response := await call.read(), pb.MoveEachHereResponse):
                self._deliver(response)
        except grpc.RpcError as error:
            failure = from_rpc_error(error, self._target)
            self._is_supported = error.code() is not grpc.StatusCode.UNIMPLEMENTED
        except StampedeError as error:
            failure = error
        finally:
            self._stream = None
            writing.cancel()
            call.cancel()
            self._fail(failure)  # before the next await: a request that comes meanwhile begins another stream
            await asyncio.gather(writing, return_exceptions=True)

    async def _write(self, call: Any) -> None:
        while True:  # until `_run` cancels this task; the task that reads gets the error of a broken stream
            await self._wakeup.wait()
            self._wakeup.clear()
            while new := [*islice(self._new, NAMED_MAX)]:
                for channel_id in new:
                    del self._new[channel_id]
                await call.write(pb.MoveEachHereRequest(channel_ids=new))

    def _deliver(self, response: pb.MoveEachHereResponse) -> None:
        for outcome in response.outcomes:
            answer = self._answers.pop(outcome.channel_id, None)
            if answer is None or answer.done():
                continue
            if outcome.HasField("error"):
                answer.set_exception(from_error_message(outcome.error))
            else:
                answer.set_result(None)

    def _fail(self, failure: StampedeError) -> None:
        answers, self._answers = self._answers, {}
        self._new.clear()
        for answer in answers.values():
            if not answer.done():
                answer.set_exception(failure)

    async def aclose(self) -> None:
        """End the stream and the connection."""
        if self._stream is not None:
            self._stream.cancel()
            await asyncio.gather(self._stream, return_exceptions=True)
        await self._channel.close(None)
