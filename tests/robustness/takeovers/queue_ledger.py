"""The answers to producers and takers of a queue, and the promises that these answers must keep."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

ROUNDING_SECONDS = 1e-6  # the hosts count in nanoseconds, and the loop in floats
Message = tuple[int, int]
"""A producer and the number of its message."""


class Delivery(NamedTuple):
    """A delivery that a taker got. Its lease lasts until `ends_s` at least. `number`: the number of deliveries of the
    message so far.
    """

    delivery_id: int
    number: int
    taker_id: int
    ends_s: float


@dataclass
class Incarnation:
    """The facts of one incarnation of one queue. No host may forget any of them."""

    messages: dict[int, Message] = field(default_factory=dict)  # by seq
    seqs: dict[Message, int] = field(default_factory=dict)
    put: set[Message] = field(default_factory=set)  # acknowledged puts
    deliveries: dict[Message, dict[int, Delivery]] = field(default_factory=dict)  # by delivery id
    given_back: set[int] = field(default_factory=set)  # deliveries
    acked: set[Message] = field(default_factory=set)  # a host has confirmed the ack
    perhaps_acked: dict[int, Message] = field(default_factory=dict)  # by delivery id: acks without an answer
    left_s: dict[Message, float] = field(default_factory=dict)  # when a host confirmed an ack or a termination

    def accepted(self, message: Message, seq: int) -> None:
        """Note an acknowledged put."""
        self.known_as(message, seq)
        self.put.add(message)

    def known_as(self, message: Message, seq: int) -> None:
        """Note the seq of a message. Raises AssertionError if the message already has another seq, or the seq
        another message.
        """
        assert self.seqs.setdefault(message, seq) == seq, f"message {message} is there twice"
        assert self.messages.setdefault(seq, message) == message, f"two messages have the seq {seq}"

    def delivered(self, message: Message, seq: int, delivery: Delivery, sent_s: float) -> bool:
        """Note a delivery, which the host sent at `sent_s`. Returns False if it came before, on another stream."""
        self.known_as(message, seq)
        assert sent_s <= self.left_s.get(message, sent_s), f"message {message} came back after its ack"
        there = self.deliveries.setdefault(message, {})
        if delivery.delivery_id in there:
            return False
        for other in there.values():
            is_later = delivery.delivery_id > other.delivery_id
            assert is_later == (delivery.number > other.number), f"a count of {message} went back: {other}, {delivery}"
            is_free = other.delivery_id in self.given_back or other.ends_s <= sent_s + ROUNDING_SECONDS
            assert is_free or not is_later, f"message {message} is leased to two takers: {other}, {delivery}"
        there[delivery.delivery_id] = delivery
        return True

    def lost(self) -> set[Message]:
        """The acknowledged messages that no taker has acked."""
        return self.put - self.acked - {*self.perhaps_acked.values()}


@dataclass
class Ledger:
    """One queue, by incarnation."""

    incarnations: dict[int, Incarnation] = field(default_factory=dict)

    def of(self, incarnation: int) -> Incarnation:
        """The facts of an incarnation."""
        return self.incarnations.setdefault(incarnation, Incarnation())

    def put(self) -> int:
        """The number of acknowledged puts."""
        return sum(len(one.put) for one in self.incarnations.values())

    def messages(self) -> set[Message]:
        """All messages that a producer or a taker knows."""
        return {message for one in self.incarnations.values() for message in one.seqs}
