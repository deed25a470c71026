"""Maps the ring of a channel, which the host passes over its Unix socket (`ChannelService.ShareMemory`)."""

from __future__ import annotations

import fcntl
import mmap
import os
import socket
import threading
import time
from collections.abc import Iterable

from stampede_rt.errors import InvalidArgument, StampedeError, Unavailable
from stampede_rt.ring.layout import CHANGES_WORD, OPEN, RING_BYTES_MAX, SEQUENCE_WORD, STATE_WORD, WORD_BYTES
from stampede_rt.ring.newest import FoundNewest
from stampede_rt.ring.ring_view import RingView
from stampede_rt.status import from_rpc_error
from stampede_rt.transports import forking, futexes
from stampede_rt.transports.mapped_pages import take_pages
from stampede_rt.transports.socket_errors import error_of
from stampede_rt.transports.socket_limits import CONNECT_S_MAX, RECEIVED_BYTES_MAX
from stampede_rt.transports.socket_routes import SocketRoute, opening_of
from stampede_rt.transports.tcp_route import SocketConnection
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.stream_frames import FrameKind, FrameReader, frame_of

SHARE_METHOD = "/stampede_rt.v1.ChannelService/ShareMemory"
WAIT_S_MAX = 0.5  # the longest wait between two looks of a reader at the host's fence
_LISTENING_PERIOD_NANOS = 50_000_000  # a reader looks at most once in this time whether the host has closed the stream
_SEALS = 0x2 | 0x4 | 0x10  # F_SEAL_SHRINK, GROW and FUTURE_WRITE
_GET_SEALS = getattr(fcntl, "F_GET_SEALS", 1034)
_RECEIVE_BYTES = 4096
_BOOTTIME = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
_FILES_MAX = 4
KEPT_BYTES_MAX = 2**20  # the largest newest item that a ring keeps; a connection has at most 64 rings


class ChannelNotShared(StampedeError):
    """The host does not share a channel with this policy or with such large items."""


def boottime_nanos() -> int:
    """Return CLOCK_BOOTTIME, the clock of the machine that leases use, in nanoseconds."""
    return time.clock_gettime_ns(_BOOTTIME)


class RingMapping:
    """A mapped ring, and the stream over which it came. Any thread may read it."""

    def __init__(self, connected: socket.socket, memory: mmap.mmap, frames: FrameReader) -> None:
        self.view = RingView(memoryview(memory).toreadonly())
        self._memory = memory
        self._socket = connected
        self._frames = frames
        self._changes_address = futexes.address_of(memory) + CHANGES_WORD * WORD_BYTES
        self._listened_nanos = 0
        self._mutex = threading.Lock()  # held by the thread that listens
        self._is_ended = False
        self._newest: tuple[int, FoundNewest] | None = None  # with the sequence number of the facts that named it
        self._forks = forking.forks()
        connected.setblocking(False)
        forking.keep_out_of_children(connected)

    def keep_newest(self, facts: list[int], found: FoundNewest) -> None:
        """Keep the newest item, so that it is not copied again while the facts are the same."""
        if len(found.body) <= KEPT_BYTES_MAX:
            self._newest = facts[0], found

    def unchanged_newest(self) -> FoundNewest | None:
        """Return the kept newest item if it is still the newest one. Call `is_open` afterwards."""
        kept = self._newest
        return kept[1] if kept is not None and kept[0] == self.view.words[SEQUENCE_WORD] else None

    @property
    def may_be_open(self) -> bool:
        """Whether the ring may still be open, without a look at the stream. Call `is_open` after each read."""
        return not self._is_ended and self.view.words[STATE_WORD] == OPEN

    def is_open(self, boottime: int) -> bool:
        """Whether the host still serves the ring at `boottime`."""
        if boottime - self._listened_nanos > _LISTENING_PERIOD_NANOS and self._mutex.acquire(blocking=False):
            try:
                self._listened_nanos = boottime
                self._listen()
            finally:
                self._mutex.release()
        return not self._is_ended and self.view.is_open(boottime)

    def _listen(self) -> None:
        """Read the host's signs of life from the stream, and note its end."""
        try:
            while data := self._socket.recv(_RECEIVE_BYTES):
                if any(kind != FrameKind.ALIVE for kind, _ in self._frames.feed(data)):
                    break
        except BlockingIOError:
            return
        except (OSError, InvalidArgument):
            pass
        self._is_ended = True

    @property
    def changes(self) -> int:
        """A number that changes after each change of the ring. Read it before you read the ring and then `wait`."""
        return int(self.view.words[CHANGES_WORD])

    @property
    def changes_address(self) -> int:
        """The address of the word on which readers wait."""
        return self._changes_address

    def wait(self, changes: int, timeout_s: float) -> None:
        """Block until the ring changes, for at most `timeout_s` and WAIT_S_MAX.

        `changes`: the value of `changes` before the last read.
        """
        futexes.wait(self._changes_address, changes, min(timeout_s, WAIT_S_MAX))

    def wake(self) -> None:
        """Wake all callers that wait for this ring, so that they look again."""
        futexes.wake(self._changes_address)

    def close(self) -> None:
        """Close the ring, and wake the waiting callers.

        The system frees the memory after its last user. Idempotent.
        """
        self._is_ended = True
        if self._forks == forking.forks():
            self._socket.close()
            self.wake()


def receive_ring(
    route: SocketRoute,
    connected: SocketConnection | None,
    metadata: Iterable[tuple[str, str]],
    channel_id: bytes,
    epoch: int,
) -> RingMapping | None:
    """Ask for a ring over a new connection, and map it. None: there is no connection, or the host shares no memory.

    Blocks for at most CONNECT_S_MAX for each step. Closes the connection if there is no ring. Raises the errors of the
    host, ChannelNotShared, and Unavailable if no ring came.
    """
    if connected is None:
        return None
    if not (route.shares_memory and connected.is_local):
        connected.close()
        return None
    try:
        return _receive_ring(connected.socket, opening_of(SHARE_METHOD, metadata, route.ticket), channel_id, epoch)
    except OSError as error:
        connected.close()
        raise Unavailable(f"no shared memory came over the host's socket: {error.strerror or error}") from error
    except BaseException:
        connected.close()
        raise


def _receive_ring(connected: socket.socket, opening: bytes, channel_id: bytes, epoch: int) -> RingMapping:
    connected.settimeout(CONNECT_S_MAX)
    request = pb.ShareMemoryRequest(channel_id=channel_id, epoch=epoch).SerializeToString()
    connected.sendall(frame_of(FrameKind.OPENING, opening) + frame_of(FrameKind.MESSAGE, request))
    frames, files = FrameReader(RECEIVED_BYTES_MAX), list[int]()
    try:
        response = _response(connected, frames, files)
        if not response.memory_bytes:
            raise ChannelNotShared(f"the host does not share this channel: {response.detail}")
        if not files:
            raise Unavailable("the host sent no file with its memory; install the same release on both")
        return RingMapping(connected, _mapped(files[0], response.memory_bytes), frames)
    finally:
        for file in files:
            os.close(file)


def _response(connected: socket.socket, frames: FrameReader, files: list[int]) -> pb.ShareMemoryResponse:
    """Return the host's answer. Adds the numbers of the received files to `files`."""
    while True:
        data, received, _, _ = socket.recv_fds(connected, _RECEIVE_BYTES, _FILES_MAX, socket.MSG_CMSG_CLOEXEC)
        files += received
        if not data:
            raise Unavailable("the host closed its socket before it sent its memory")
        for kind, body in frames.feed(data):
            if kind == FrameKind.MESSAGE:
                return pb.ShareMemoryResponse.FromString(bytes(body))
            if kind == FrameKind.STATUS:
                error = error_of(body)
                raise from_rpc_error(error, "the host") if error else Unavailable("the host shares no memory now")


def _mapped(file: int, memory_bytes: int) -> mmap.mmap:
    """Map the file, after a check that no process can shrink it. If a process shrank it, a read would end this process
    by a signal.
    """
    found_bytes, seals = os.fstat(file).st_size, fcntl.fcntl(file, _GET_SEALS)
    if found_bytes != memory_bytes or memory_bytes > RING_BYTES_MAX or seals & _SEALS != _SEALS:
        raise InvalidArgument(
            f"the host sent a file of {found_bytes} bytes with the seals {seals:#x} as its shared memory; it is "
            "defective, or not of this product: replace it"
        )
    mapped = mmap.mmap(file, memory_bytes, prot=mmap.PROT_READ)
    take_pages(mapped, to_write=False)
    return mapped
