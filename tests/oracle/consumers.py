"""The oracle's consumer places: leases, and the items that each consumer has consumed."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class OraclePlace:
    """A place that a consumer has taken.

    While its lease is valid, the place holds back all items from seq `start` on that the consumer has not consumed.
    Without a lease it holds nothing back.
    """

    consumer_id: int
    until: int
    start: int
    consumed: set[int] = field(default_factory=set)
    ended: bool = False

    def owes(self, seq: int) -> bool:
        return not self.ended and seq >= self.start and seq not in self.consumed


class OracleConsumers:
    """A number of consumer places. The rules:

    - An item may leave once every place lets it go. A place that was never taken holds back all items.
    - A consumer takes a place with its first `consume`, and keeps it by a lease. Each further `consume` renews the
      lease.
    - A place whose lease has ended holds back nothing until a consumer takes it again. This consumer starts at the
      newest item.
    - A consumer that has a place keeps it. A new consumer gets the place whose lease ended first. If there is none, it
      gets a place that was never taken. Otherwise the call is refused.
    - If the number of places grows, the new places were never taken. If it shrinks, places with a lease stay before
      places without one, and longer leases before shorter ones.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.taken: list[OraclePlace] = []

    @property
    def untaken(self) -> int:
        return self.number - len(self.taken)

    @property
    def live(self) -> list[OraclePlace]:
        return [place for place in self.taken if not place.ended]

    def expire(self, clock: int) -> None:
        for place in self.taken:
            place.ended = place.ended or place.until <= clock

    def owed(self, seq: int) -> bool:
        """Whether a consumer with a valid lease has not consumed the item yet."""
        return any(place.owes(seq) for place in self.live)

    def next_lease_end(self) -> int | None:
        return min((place.until for place in self.live), default=None)

    def place_for(self, consumer_id: int, newest_seq: int) -> OraclePlace | None:
        """The consumer's place. A consumer without one takes a place now. None: no place is free."""
        own = [place for place in self.taken if place.consumer_id == consumer_id]
        if own and not own[0].ended:
            return own[0]
        ended = sorted((place for place in self.taken if place.ended), key=lambda place: place.until)
        if not own and not ended and not self.untaken:
            return None
        former = (own or ended)[:1]
        place = OraclePlace(consumer_id, 0, start=newest_seq if former else 0)
        self.taken = [one for one in self.taken if one not in former] + [place]
        return place

    def move(self, clock: int) -> None:
        """Move the places to another owner.

        The new owner learns only the order in which leases have ended, not when.
        """
        self.taken.sort(key=lambda place: (not place.ended, place.until))
        for place in self.taken:
            place.until = clock - 1 if place.ended else place.until

    def resize(self, number: int) -> None:
        self.number = number
        worst_first = sorted(self.taken, key=lambda place: (not place.ended, place.until))
        for place in worst_first[: max(0, len(self.taken) - number)]:
            self.taken.remove(place)
