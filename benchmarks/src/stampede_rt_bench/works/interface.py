"""What a system must offer to be measured: a server that the benchmark starts, and a client with five kinds of work.

A client's methods take iterators, and the loop is inside the client. So a client on asyncio keeps its loop running from
one operation to the next, as its users do.
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
    """What the work needs: the bytes of an item, items that may wait in any queue, readers, items to be read later."""

    item_bytes: int
    items_max: int
    batch_items: int
    readers: int = 1
    keeps: bool = False


@dataclass(frozen=True, kw_only=True)
class Served:
    """A running server: where clients find it, and the processes whose CPU time belongs to it."""

    address: str
    pids: Sequence[int] = ()
    environment: Mapping[str, str] = field(default_factory=dict)


class Receiver(Protocol):
    """Where a client puts what it reads."""

    def ready(self) -> None:
        """The subscription stands: everything published from now on will come."""

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
    """Something that can be measured. Its objects travel to the processes that use it."""

    @property
    def name(self) -> str:
        """As tables show it."""

    @property
    def lacks(self) -> Mapping[str, str]:
        """By the kind of work (`put`, `newest`, `interval`, `stream`, `frames`, `latency`), why it cannot do that."""

    def unavailable_because(self) -> str | None:
        """What is missing on this machine and how to get it; None if nothing is."""

    def served(self, room: Room) -> AbstractContextManager[Served]:
        """A fresh server, gone afterwards."""

    def connect(self, served: Served, room: Room) -> Client:
        """A client of it, in the calling process."""
