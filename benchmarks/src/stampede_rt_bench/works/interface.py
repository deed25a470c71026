"""The interface of a measured system: a server that the benchmark starts, and a client with five kinds of work.

A client's methods take iterators, and the client iterates. So the event loop of a client on asyncio runs from one
operation to the next, as in a user's program.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

Step = Sequence[bytes] | float  # payloads to publish, or the seconds to wait for the next step
Block = bytes | bytearray


@dataclass(frozen=True, kw_only=True)
class Room:
    """The needs of the work: bytes of an item, items that may wait in a queue, readers, items to be read later."""

    item_bytes: int
    items_max: int
    batch_items: int
    readers: int = 1
    keeps: bool = False


@dataclass(frozen=True, kw_only=True)
class Served:
    """A running server: its address, and the processes whose CPU time belongs to it."""

    address: str
    pids: Sequence[int] = ()
    environment: Mapping[str, str] = field(default_factory=dict)


class Receiver(Protocol):
    """Takes the items that a client reads."""

    def ready(self) -> None:
        """Note that the subscription is open: every item that is published from now on will come."""

    def take(self, time_nanos: int, seq: int, payload: bytes) -> None:
        """One item. A system without times or seqs gives 0."""

    def take_block(self, items: int, payload: Block) -> None:
        """Items of a limit, which moves bytes and knows no items."""

    def ended(self) -> bool:
        """Whether to stop. A client asks at least ten times a second."""


class Client(Protocol):
    """One connection, in the process that uses it."""

    def put(self, payloads: Iterator[bytes]) -> None:
        """Put each, and wait for its acknowledgement before taking the next."""

    def newest(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read the newest item in each turn."""

    def interval(self, turns: Iterator[int], receiver: Receiver) -> None:
        """Read in each turn the oldest items in one get; the turn says how many."""

    def publish(self, steps: Iterator[Step]) -> None:
        """Send the payloads of each step, with a bound on what is on its way. Return when all are sent."""

    def subscribe(self, receiver: Receiver) -> None:
        """Give the receiver every item until it has ended."""

    def close(self) -> None:
        """End the connection."""


class System(Protocol):
    """A system that can be measured. Its objects are pickled for the processes that use them."""

    @property
    def name(self) -> str:
        """As tables show it."""

    @property
    def lacks(self) -> Mapping[str, str]:
        """By the kind of work (`put`, `newest`, `interval`, `stream`, `frames`, `latency`), why it cannot do that."""

    def unavailable_because(self) -> str | None:
        """Return what is missing on this machine and how to install it; None if nothing is."""

    def served(self, room: Room) -> AbstractContextManager[Served]:
        """Return a context with a new server, which ends with the context."""

    def connect(self, served: Served, room: Room) -> Client:
        """A client of it, in the calling process."""
