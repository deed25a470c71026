"""The open streams of a host. The host ends a stream with an error, for example because its channel was deleted, the
lease was lost, or the host shuts down.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from contextvars import copy_context
from typing import Any

from grpc.aio import InternalError

from stampede_rt.errors import StampedeError
from stampede_rt.status import abort
from stampede_rt_channel_host.core.channel import batched
from stampede_rt_runtime.access.control import current_account
from stampede_rt_runtime.error_frames import drop_frames, failure_of
from stampede_rt_runtime.quotas.working import charged
from stampede_rt_runtime.rpc import Context

logger = logging.getLogger(__name__)

STREAMS_PER_TURN = 16
"""The most streams that end in one turn of the event loop when all streams end."""


class OpenStream:
    """One open stream. Its handler runs inside `OpenStreams.serve`."""

    def __init__(self, task: asyncio.Task[Any]) -> None:
        """`task` runs the handler, and is the present task."""
        self._task = task
        self._account = current_account()
        self._variables = copy_context()
        self.error: StampedeError | None = None

    def end(self, error: StampedeError) -> None:
        """Interrupt the handler, wherever it waits, and end the RPC with `error`. Only the first error counts."""
        if self.error is None:
            self.error = error
            self._task.cancel()

    def spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run `work` while the handler runs, and count it for the stream's caller. A failure of `work` ends the stream.

        The handler must await or cancel the returned task. Another caller's call may spawn it, for example a put that
        releases a get. Therefore `work` gets the context variables of the handler.
        """
        task = asyncio.create_task(charged(self._account, work), context=self._variables)
        task.add_done_callback(self._check)
        return task

    def _check(self, task: asyncio.Task[None]) -> None:
        failure = failure_of(task)
        if failure is None:
            return
        if isinstance(failure, InternalError):
            self._task.cancel()  # gRPC could not write, because the caller has gone
        elif isinstance(failure, StampedeError):
            self.end(failure)
        else:
            logger.error("a stream failed", exc_info=failure, extra={"event": "stream_defect"})
            self.end(StampedeError(f"the host failed to serve the stream ({failure!r}); please report it"))
        drop_frames(failure)


class OpenStreams:
    """All streams of a host. The server's limit of concurrent RPCs bounds their number."""

    def __init__(self) -> None:
        self._streams: set[OpenStream] = set()
        self._closing: StampedeError | None = None
        self._changed = asyncio.Event()

    @asynccontextmanager
    async def serve(self, context: Context) -> AsyncIterator[OpenStream]:
        """Run a handler's body. A StampedeError from `end` or from the body becomes the RPC's status."""
        task = asyncio.current_task()
        assert task is not None, "handlers run in tasks"
        stream = OpenStream(task)
        if self._closing is not None:
            await abort(context, self._closing)
        self._streams.add(stream)
        try:
            yield stream
        except StampedeError as error:
            await _end(context, error)
        except InternalError as error:
            logger.debug("the caller left during a write", extra={"event": "caller_left", "why": str(error)})
            raise asyncio.CancelledError from error  # there is no caller left for a status
        except asyncio.CancelledError:
            if stream.error is None:
                raise  # the caller cancelled
            task.uncancel()
            await _end(context, stream.error)
        finally:
            self._streams.discard(stream)
            self._changed.set()

    async def end_all(self, error: StampedeError) -> None:
        """End every stream with `error`, refuse new streams with the same error, and wait until no stream is left."""
        self._closing = error
        for streams in batched(list(self._streams), STREAMS_PER_TURN):
            for stream in streams:
                stream.end(error)
            await asyncio.sleep(0)
        while self._streams:
            self._changed.clear()
            await self._changed.wait()


async def _end(context: Context, error: StampedeError) -> None:
    """End the RPC with `error`.

    Does not wait until the caller has read all messages: gRPC keeps the status until then.
    """
    try:
        await abort(context, error)
    except InternalError as failure:
        logger.debug("the caller left before the status was sent", extra={"event": "caller_left", "why": str(failure)})
        raise asyncio.CancelledError from failure
