"""The interface of a measured system: a server that the benchmark starts, and a client with five kinds of workload.

A client's methods take iterators, and the client itself loops over them. The event loop of an asyncio client therefore
keeps running between two operations, as in a user's program.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

Step = Sequence[bytes] | float  # payloads to publish, or the seconds to wait for the next step
Block = bytes | bytearray


@dataclass(frozen=True, kw_only=True)
class WorkloadNeeds:
    """The needs of a workload: the size of an item, the items that may wait in a queue, and the number of readers.

    `batch_items`: the items of one batch. `keeps`: the server must keep the items, so that clients can read them later.
    """

    item_bytes: int
    items_max: int
    batch_items: int
    readers: int = 1
    keeps: bool = False


@dataclass(frozen=True, kw_only=True)
class RunningServer:
    """A running server: its address, and the processes whose CPU time belongs to it."""

    address: str
    pids: Sequence[int] = ()
    environment: Mapping[str, str] = field(default_factory=dict)


class Receiver(Protocol):
    """Takes the items that a client reads."""

    def ready(self) -> None:
        """Note that the subscription is open: every item that is published from now on will come."""

    def take(self, time_nanos: int, seq: int, payload: bytes) -> None:
        """Take one item. A system without times or seqs gives 0."""

    def take_block(self, items: int, payload: Block) -> None:
        """Take `items` items in one payload. Only the systems in `limits` call this: they have no items."""

    def ended(self) -> bool:
        """Whether the client must stop. The client asks at least ten times a second."""


class Client(Protocol):
    """One connection, in the process that uses it."""

    def put(self, payloads: Iterator[bytes]) -> None:
        """Put each payload, and wait for its acknowledgement before taking the next one."""

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the newest item in each turn."""

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the oldest items with one get in each turn. `turns` gives the number of items."""

    def publish(self, steps: Iterator[Step]) -> None:
        """Send the payloads of each step, with a bound on the unacknowledged payloads. Return when all are sent."""

    def subscribe(self, receiver: Receiver) -> None:
        """Give the receiver every item until it has ended."""

    def close(self) -> None:
        """End the connection."""


class MeasuredSystem(Protocol):
    """A system that can be measured. Its objects are pickled for the processes that use them."""

    @property
    def name(self) -> str:
        """The name of the system in tables."""

    @property
    def unsupported(self) -> Mapping[str, str]:
        """The kinds of workload that the system cannot run (such as `put` or `frames`), each with the reason."""

    def unavailable_because(self) -> str | None:
        """Return which part is missing on this machine, and how to install it; None if none is missing."""

    def served(self, needs: WorkloadNeeds) -> AbstractContextManager[RunningServer]:
        """Return a context with a new server, which ends with the context."""

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> Client:
        """Return a client of the server, for the calling process."""
