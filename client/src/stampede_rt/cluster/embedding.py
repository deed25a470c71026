"""A channel host inside the program's own process: its settings, and the package that brings the code of the host.

The client imports no service. The package of the host registers a function as an entry point, and `embedder` finds it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

from stampede_rt.cluster.connecting import Target
from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.values.model import Reason
from stampede_rt.values.policy import flag_of, memory_of, size_of
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import DurationLike, ResolvedInterval, parse_duration

ENTRY_POINTS = "stampede_rt.embedded_hosts"
START_TIMEOUT_S = 15.0  # enough to wait for the end of the lease of a predecessor with the same name, within 6 s
DRAIN_MAX_NANOS = 3600 * 10**9
NO_ATTRIBUTES: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, kw_only=True, slots=True)
class HostOptions:
    """The arguments of `stampede_rt.host` that concern the host.

    `listen`, `advertise`, `archive` and `archive_folder`: empty if not given; the host checks them.
    `archive_bytes_max`: 0 if not given.
    """

    listen: str
    advertise: str
    memory_bytes_max: int
    drain_s: float
    allow_insecure_anywhere: bool
    private: bool
    archive: str
    archive_folder: str
    archive_bytes_max: int

    @classmethod
    def parse(
        cls,
        listen: str | None,
        advertise: str | None,
        max_memory: int | str,
        drain: DurationLike,
        allow_insecure_anywhere: bool,
        private: bool = False,
        archive: str | os.PathLike[str] | None = None,
        archive_folder: str | os.PathLike[str] | None = None,
        max_archive: int | str | None = None,
    ) -> HostOptions:
        """Check the arguments. Raises InvalidArgument."""
        drain_nanos = parse_duration(drain, "drain")
        if not 0 <= drain_nanos <= DRAIN_MAX_NANOS:
            raise InvalidArgument(f'drain is {drain!r}; it must be from "0s" to "1h"')
        return cls(
            listen=listen or "",
            advertise=advertise or "",
            memory_bytes_max=memory_of("max_memory", max_memory),
            drain_s=drain_nanos / 1e9,
            allow_insecure_anywhere=flag_of("allow_insecure_anywhere", allow_insecure_anywhere),
            private=flag_of("private", private),
            archive=_place_of("archive", archive),
            archive_folder=_place_of("archive_folder", archive_folder),
            archive_bytes_max=0 if max_archive is None else size_of("max_archive", max_archive),
        )


def _place_of(what: str, value: str | os.PathLike[str] | None) -> str:
    """Return `value` as text; empty for None. Raises InvalidArgument."""
    if value is None:
        return ""
    place = os.fspath(value) if isinstance(value, str | os.PathLike) else value
    if not isinstance(place, str) or not place.strip():
        raise InvalidArgument(f"{what} is {value!r}; give a folder, or the URL of an object store, or leave it out")
    return place


class InProcessPut(NamedTuple):
    """One item that a program puts at the host of its own process. If `time` is None, the host stamps the item.

    `ack` is a number of the enum Ack, for the wanted acknowledgement. `wait_nanos`: the longest wait for it.
    """

    producer_id: int
    number: int
    payload: bytes
    time: int | None
    duration: int | None
    attributes: dict[str, str]
    content_type: str
    ack: int
    wait_nanos: int


class InProcessRun(NamedTuple):
    """One item that this process put, or, if `encoded` is set, a run that came over the wire.

    `duration` is -1 for none. `payload` is the object that was put. `next_time`: the time of the bucket after the run;
    None: the next run begins that bucket, or the run has the newest bucket.
    """

    time: int = 0
    duration: int = -1
    seq: int = 0
    length: int = 0
    payload: bytes | None = None
    attributes: Mapping[str, str] = NO_ATTRIBUTES
    content_type: str = ""
    next_time: int | None = None
    encoded: bytes | None = None


class InProcessAnswer(NamedTuple):
    """The answer to a read at the host of this process. The fields are as in `Items`."""

    runs: Sequence[InProcessRun]
    interval: ResolvedInterval | None
    complete: bool
    truncated: bool
    more: bool
    reason: Reason | None
    incarnation: int


class RunToPut(Protocol):
    """A run of a producer."""

    @property
    def first_number(self) -> int:
        """The producer's number of the first item."""
        ...

    @property
    def items(self) -> int:
        """The number of items."""
        ...

    @property
    def encoded(self) -> Sequence[bytes]:
        """The bytes of the run, in pieces."""
        ...


class InProcessRunStream(Protocol):
    """A producer's stream of runs to the host of this process. Any thread may use it, and no call waits."""

    def send(self, runs: Sequence[RunToPut]) -> None:
        """Send runs. Raises Unavailable if the host has ended."""
        ...

    def cancel(self) -> None:
        """End the stream."""
        ...


class InProcessHost(Protocol):
    """A channel host in this process. Several threads may use it."""

    @property
    def name(self) -> str:
        """The host's name in the directory."""
        ...

    @property
    def target(self) -> str:
        """The address at which others reach the host."""
        ...

    @property
    def is_interrupted(self) -> bool:
        """Whether the calling code interrupts a step of the host on its thread, as `__del__` may. The host goes on when
        the call ends, so the call must not wait for it."""
        ...

    def start(self, timeout_s: float) -> None:
        """Start the host on a thread of its own, and wait until the directory knows it. Raises StampedeError."""
        ...

    def put(self, channel_id: bytes, epoch: int, put: InProcessPut) -> Future[Any]:
        """Put one item by reference. The future gets the PutAck, or None if the put must go over a stream.

        To cancel the future ends the wait for the disk. The channel may have the item nevertheless.
        """
        ...

    def puts(
        self,
        channel_id: bytes,
        epoch: int,
        producer_id: int,
        ack: int,
        on_acks: Callable[[Any], None],
        on_end: Callable[[StampedeError], None],
    ) -> InProcessRunStream | None:
        """Open a stream of runs. Returns None if the runs must go over a stream of the transport. Does not wait.

        `ack`: see `InProcessPut`. The host's thread passes each PutResponse to `on_acks`, and the error that ends the
        stream to `on_end`.
        """
        ...

    def read_now(self, channel_id: bytes, epoch: int, query: ReadQuery) -> InProcessAnswer | None:
        """Read by reference on the calling thread. None: call `read` instead. Raises StampedeError."""
        ...

    def at_now(self, channel_id: bytes, epoch: int, time: int) -> InProcessAnswer | None:
        """Read at an instant by reference on the calling thread. None: call `read_now` instead. Raises
        StampedeError."""
        ...

    def newest_now(self, channel_id: bytes, epoch: int) -> InProcessAnswer | None:
        """Read the newest item by reference on the calling thread. None: call `read_now` instead."""
        ...

    def read(self, channel_id: bytes, epoch: int, query: ReadQuery) -> Future[InProcessAnswer | None]:
        """Read by reference, with the wait of the query. None: the read must go over a stream."""
        ...

    def leave(self) -> None:
        """Move the channels to other hosts, deregister the host, and end its thread. Idempotent.

        Blocks for the drain and for some seconds more. In a forked child it does nothing.
        """
        ...


Embedder = Callable[[Target, HostOptions], InProcessHost]


def embedder() -> Embedder:
    """Return the function that makes a host for this process. Raises InvalidArgument if no package has it."""
    from importlib.metadata import entry_points

    for point in entry_points(group=ENTRY_POINTS):
        found: Embedder = point.load()
        return found
    raise InvalidArgument(
        "this process cannot host channels, because the code of the host is not installed: it belongs to the extra "
        "[server] of stampede-rt; install that extra as you installed stampede-rt, or run `make setup` in a clone "
        "of the repository"
    )
