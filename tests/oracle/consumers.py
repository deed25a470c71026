"""Consumers by the book: places, leases, and who has consumed which item."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class OraclePlace:
    """A place that somebody took. Without a lease it holds nothing; with one, all that its consumer has not consumed,
    but nothing with a seq below `start`."""

    consumer_id: int
    until: int
    start: int
    consumed: set[int] = field(default_factory=set)
    ended: bool = False

    def owes(self, seq: int) -> bool:
        return not self.ended and seq >= self.start and seq not in self.consumed


class OracleConsumers:
    """A number of places. The rules:

    - An item may go once every place lets it go. A place that was never taken lets nothing go.
    - A consumer takes a place with its first `consume` and keeps it by a lease, which each further one renews.
    - A place whose lease has ended lets everything go until it is taken again; who takes it starts at the newest item.
    - A consumer that has a place finds it again. A new one gets the place that ended first, else one never taken, else
      it is refused.
    - More places are places never taken. Of fewer, those with a lease stay before those without, longer leases first.
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
        """Some live consumer has yet to consume it."""
        return any(place.owes(seq) for place in self.live)

    def next_lease_end(self) -> int | None:
        return min((place.until for place in self.live), default=None)

    def place_for(self, consumer_id: int, newest_seq: int) -> OraclePlace | None:
        """The consumer's place, which it takes now if it has none; None if there is none for it."""
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

    def carry(self, clock: int) -> None:
        """The places go to another owner: of leases that have ended it is told the order, not when they did."""
        self.taken.sort(key=lambda place: (not place.ended, place.until))
        for place in self.taken:
            place.until = clock - 1 if place.ended else place.until

    def resize(self, number: int) -> None:
        self.number = number
        worst_first = sorted(self.taken, key=lambda place: (not place.ended, place.until))
        for place in worst_first[: max(0, len(self.taken) - number)]:
            self.taken.remove(place)
