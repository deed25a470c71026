"""The owner's facts at a copy: consumer places that come in several parts."""

from __future__ import annotations

from stampede_rt_channel_host.core.channel import ConsumerPlace, Counters, FedPlaces, OwnerPart
from stampede_rt_channel_host.core.channel.owner_facts import OwnerFacts

COUNTERS = Counters(accepted=0, held=0, collected={}, rejected={}, accepted_bytes=0, held_bytes=0, late=0)


def part(*places: ConsumerPlace, begins: bool = False, ends: bool = False) -> OwnerPart:
    return OwnerPart((), FedPlaces(begins, places, ends=ends), COUNTERS, None)


def test_a_lease_goes_on_while_further_parts_of_the_places_come() -> None:
    facts = OwnerFacts()
    facts.apply(part(ConsumerPlace(1, 3, 1, ()), ConsumerPlace(2, 50, 1, ()), begins=True), 0)
    facts.apply(part(ConsumerPlace(3, 50, 1, ())), 10)
    facts.apply(part(ends=True), 30)
    assert [(one.consumer_id, one.lease_nanos) for one in facts.places(31)] == [(1, 0), (2, 19), (3, 29)]


def test_a_repeated_part_of_the_places_changes_nothing() -> None:
    facts = OwnerFacts()
    parts = [
        part(ConsumerPlace(1, 50, 3, ((5, 6), (8, 9))), begins=True), part(ConsumerPlace(1, 50, 3, ((11, 12),))),
        part(ConsumerPlace(2, 50, 1, ())), part(ends=True),
    ]  # fmt: skip
    for one in parts:
        facts.apply(one, 0)
        facts.apply(one, 0)
    expected = [ConsumerPlace(1, 50, 3, ((5, 6), (8, 9), (11, 12))), ConsumerPlace(2, 50, 1, ())]
    assert facts.places(0) == expected
