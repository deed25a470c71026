"""A channel host inside another program's process: `stampede_rt.host` (paper, section 4.2).

The host has a thread and an event loop of its own, so it serves others while the program is busy. It never changes
settings of the whole process, such as signal handlers, limits or the garbage collector.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from functools import partial
from typing import Any, TypeVar
from weakref import WeakSet

from stampede_rt.cluster.connecting import Target
from stampede_rt.cluster.embedding import HostOptions, InProcessAnswer, InProcessPut
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.reading import ReadQuery
from stampede_rt_channel_host.channels.calls_here import at_now, newest_now, put_here, read_here, read_now
from stampede_rt_channel_host.channels.gets.waiting_get import WaitingGet
from stampede_rt_channel_host.channels.in_process_puts import InProcessPutStream, takes_runs
from stampede_rt_channel_host.channels.puts.held_acks import HeldAck
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.embedded_settings import MISUSES, cannot_host, credentials_of, settings_of
from stampede_rt_channel_host.forked_sockets import close_copies
from stampede_rt_channel_host.served_host import ServedHost
from stampede_rt_channel_host.turns import LoopTurns
from stampede_rt_runtime.settings import SettingsError
from stampede_rt_runtime.working_threads import WorkingThreads

logger = logging.getLogger(__name__)
Found = TypeVar("Found")

ANSWER_SECONDS = 2.0  # `start` waits this much longer than `enter` of the host, so that it gets the host's error
THREADS_MAX = 8  # for calls that block, besides those of the archive
LEAVE_SECONDS_MAX = 10.0  # the most that the end of a host takes, after its drain


class EmbeddedHost:
    """A host on a thread of this process, from `start` to `leave`. It also leaves when the main thread has ended."""

    def __init__(self, target: Target, options: HostOptions) -> None:
        self._credentials = credentials_of(target.credentials)
        self._drain_s = options.drain_s
        self._start_timeout_s = 0.0
        self._settings = settings_of(target, options)
        self._process = os.getpid()
        self._served: ServedHost | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop = asyncio.Event()
        self._is_leaving = False  # may be True before the loop runs
        self._has_ended = False
        self._pending_answers: set[Future[Any]] = set()  # calls that the loop has still to answer
        self._puts: set[InProcessPutStream] = set()  # the open streams of producers
        self._started: Future[None] = Future()
        self._turns = LoopTurns()
        # not a daemon: when the program ends without a close, the interpreter waits until the host has left
        self._thread = threading.Thread(target=self._run, name="stampede host", daemon=False)

    @property
    def name(self) -> str:
        """The host's name in the directory."""
        return "" if self._served is None else self._served.host.identity.name

    @property
    def target(self) -> str:
        """The address at which callers reach the host."""
        return "" if self._served is None else self._served.advertise

    @property
    def is_interrupted(self) -> bool:
        """See `InProcessHost`."""
        return self._turns.is_mine

    @property
    def is_alive(self) -> bool:
        """Whether the thread of the host runs, in this process."""
        return self._process == os.getpid() and self._thread.is_alive()

    def start(self, timeout_s: float) -> None:
        """Start the host, and wait until the directory knows it.

        Raises InvalidArgument if the host cannot listen or use its archive, HostExists, PermissionDenied, Unavailable.
        """
        _here.add(self)
        self._start_timeout_s = timeout_s
        self._thread.start()
        try:
            self._started.result(timeout_s + ANSWER_SECONDS)
        except TimeoutError:
            self.leave()
            raise Unavailable(f"this process did not become a host within {timeout_s:.0f} s; try again") from None
        except MISUSES as error:
            raise cannot_host(error) from error

    def leave(self) -> None:
        """Move the channels to other hosts, deregister the host, and end its thread. Idempotent.

        Blocks for the drain and for LEAVE_SECONDS_MAX at most. In a forked child it does nothing.
        """
        if not self.is_alive:
            return
        self.ask_to_leave()
        if threading.current_thread() is not self._thread:
            self._thread.join(self._drain_s + LEAVE_SECONDS_MAX)

    def put(self, channel_id: bytes, epoch: int, put: InProcessPut) -> Future[pb.PutAck | None]:
        """Put one item by reference. The future may have the errors of a put.

        Its result is None if the put must go over a stream: the channel has replicas, or the put may have to wait for
        room.
        """

        def perform(store: ChannelStore, answer: Future[pb.PutAck | None]) -> None:
            ack = put_here(store, channel_id, epoch, put)
            if ack is None or isinstance(ack, pb.PutAck):
                _set_result(answer, ack)
            elif self._loop is not None:
                waiting = self._loop.create_task(_set_result_when_due(answer, ack))
                answer.add_done_callback(partial(_cancel, self._loop, waiting))

        return self._on_loop(perform)

    def puts(
        self,
        channel_id: bytes,
        epoch: int,
        producer_id: int,
        ack: int,
        on_acks: Callable[[Any], None],
        on_end: Callable[[StampedeError], None],
    ) -> InProcessPutStream | None:
        """Open a producer's stream of runs. None: the host has ended, or the channel needs a stream over the wire."""
        loop, served = self._loop, self._served
        try:
            takes = self._look(takes_runs, channel_id, epoch)
        except StampedeError:  # the caller opens a stream over the wire instead, and gets the error there
            return None
        if not takes or loop is None or served is None:
            return None
        opened = InProcessPutStream(loop, served.host.store, (channel_id, epoch), (producer_id, ack), on_acks, on_end)
        self._puts.add(opened)
        opened.on_over = partial(self._puts.discard, opened)
        return opened

    def read_now(self, channel_id: bytes, epoch: int, query: ReadQuery) -> InProcessAnswer | None:
        """Read by reference, without a wait. If it returns None, call `read`. Raises the errors of a get."""
        return self._look(read_now, channel_id, epoch, query)

    def at_now(self, channel_id: bytes, epoch: int, time: int) -> InProcessAnswer | None:
        """Read at an instant by reference, without a wait.

        If it returns None, call `read_now`. Raises the errors of a get.
        """
        return self._look(at_now, channel_id, epoch, time)

    def newest_now(self, channel_id: bytes, epoch: int) -> InProcessAnswer | None:
        """Read the newest item by reference, without a wait. If it returns None, call `read_now`."""
        return self._look(newest_now, channel_id, epoch)

    def _look(self, look: Callable[..., Found | None], *arguments: Any) -> Found | None:
        """Call `look` with the store, between two steps of the loop. None if the host is not there."""
        if self._served is None or self._has_ended or self._process != os.getpid():
            return None
        self._turns.let_loop_run()
        with self._turns.lock:
            return look(self._served.host.store, *arguments)

    def read(self, channel_id: bytes, epoch: int, query: ReadQuery) -> Future[InProcessAnswer | None]:
        """Read by reference, with the wait of the query. None: the read must go over a stream."""

        def perform(store: ChannelStore, answer: Future[InProcessAnswer | None]) -> None:
            waiting = read_here(store, channel_id, epoch, query, lambda found: _set_result(answer, found))
            if waiting is not None and self._loop is not None:
                answer.add_done_callback(partial(_cancel, self._loop, waiting))

        return self._on_loop(perform)

    def _on_loop(self, perform: Callable[[ChannelStore, Future[Any]], None]) -> Future[Any]:
        """Have the host's thread perform a call. Its result is None if the host has ended."""
        answer: Future[Any] = Future()
        served, loop = self._served, self._loop
        if served is None or loop is None or not self.is_alive:
            answer.set_result(None)
            return answer
        store = served.host.store
        self._pending_answers.add(answer)
        answer.add_done_callback(self._pending_answers.discard)

        def run() -> None:
            if answer.cancelled():
                return
            try:
                perform(store, answer)
            except Exception as error:  # noqa: BLE001  # the caller raises it
                _set_result(answer, error)

        try:
            loop.call_soon_threadsafe(run)
        except RuntimeError:  # the loop has closed meanwhile
            answer.set_result(None)
        return answer

    def ask_to_leave(self) -> None:
        """Begin to leave. Does not wait. Idempotent."""
        self._is_leaving = True
        loop = self._loop
        if loop is not None and not loop.is_closed():
            with contextlib.suppress(RuntimeError):  # the loop has closed meanwhile
                loop.call_soon_threadsafe(self._stop.set)

    def close_in_child(self) -> None:
        """Close the copies of the host's sockets, and of the lock of its archive, that a forked child has.

        Otherwise the port would stay open after the end of the parent, and its callers would wait for an answer. And no
        host could use the archive.
        """
        served = self._served
        if served is not None:
            close_copies(served.address, served.local.removeprefix("unix:"))
            served.close_archive_in_child()

    def _run(self) -> None:
        try:
            with asyncio.Runner(loop_factory=self._turns.loop) as runner:
                runner.run(self._serve())
        except BaseException as error:  # `start` raises it on the program's thread
            if not self._started.done():
                self._started.set_exception(error)
            else:
                logger.exception("the host in this process ended", extra={"event": "embedded_host_failed"})
        finally:
            self._has_ended = True
            self._turns.loop_ended()
            # From now on a forked child must close no sockets at the host's port: they may be of another server.
            _here.discard(self)
            for answer in [*self._pending_answers]:  # the loop no longer answers these calls
                _set_result(answer, None)
            for stream in [*self._puts]:
                stream.end(Unavailable("the host of this process has ended"))

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._loop.set_default_executor(WorkingThreads(THREADS_MAX, "stampede-host-worker"))
        if self._is_leaving:
            self._stop.set()
        try:
            served = self._served = ServedHost(self._settings, self._credentials, lambda failure: self._stop.set())
        except OSError as error:
            if isinstance(error, StampedeError):
                raise
            raise SettingsError(f"--archive: {error.filename} cannot be used: {error.strerror}") from error
        try:
            await served.listen()
            await self._enter(served)
            await self._stop.wait()
            if self._drain_s:
                await served.host.give_away(self._drain_s)
        finally:
            await served.server.stop(served.host.leave)

    async def _enter(self, served: ServedHost) -> None:
        work = served.host.enter(served.advertise, self._start_timeout_s, local_target=served.local)
        entering = asyncio.ensure_future(work)
        stopping = asyncio.ensure_future(self._stop.wait())
        await asyncio.wait({entering, stopping}, return_when=asyncio.FIRST_COMPLETED)
        stopping.cancel()
        if not entering.done():
            raise Unavailable("the host was stopped before the directory had registered it")
        entering.result()
        self._started.set_result(None)


def _set_result(answer: Future[Any], found: object) -> None:
    """Set the result of a call. Does nothing if its caller has given up."""
    with contextlib.suppress(InvalidStateError):
        if isinstance(found, Exception):
            answer.set_exception(found)
        else:
            answer.set_result(found)


async def _set_result_when_due(answer: Future[pb.PutAck | None], ack: HeldAck) -> None:
    """Set the result of a put that waits for the disk."""
    _set_result(answer, await ack.due())


def _cancel(loop: asyncio.AbstractEventLoop, waiting: WaitingGet | asyncio.Task[None], answer: Future[Any]) -> None:
    """End the wait of a call whose caller has given up. The done callback of the future refers to `waiting`."""
    if answer.cancelled():
        with contextlib.suppress(RuntimeError):  # the loop has closed
            loop.call_soon_threadsafe(waiting.cancel)


_here: WeakSet[EmbeddedHost] = WeakSet()  # the hosts of this process
_watch_started = threading.Lock()


def _leave_at_exit() -> None:
    """Wait for the end of the program's main thread, and have the hosts leave. Runs on a daemon thread.

    The threads of the hosts are not daemons, so the interpreter waits for them.
    """
    threading.main_thread().join()
    for host in [*_here]:
        host.ask_to_leave()


def _in_child() -> None:
    global _watch_started
    _watch_started = threading.Lock()
    for host in [*_here]:
        host.close_in_child()
    _here.clear()


os.register_at_fork(after_in_child=_in_child)


def embed(target: Target, options: HostOptions) -> EmbeddedHost:
    """Make the host of a program, for `stampede_rt.host`. Raises InvalidArgument, PermissionDenied.

    The first host of a process starts a thread that watches for the end of the program.
    """
    made = EmbeddedHost(target, options)
    if _watch_started.acquire(blocking=False):
        threading.Thread(target=_leave_at_exit, name="stampede host exit", daemon=True).start()
    return made
