"""The number with which a process registers, and the moment at which another process replaces it."""

from __future__ import annotations

from stampede_rt.cluster.registration_epoch import RegistrationEpoch
from stampede_rt.errors import LeaseExpired, StaleRegistration


def refusal(epoch: int, *, alive: bool) -> StaleRegistration:
    return StaleRegistration("x", metadata={"registration_epoch": str(epoch), "alive": str(alive).lower()})


def test_a_process_that_has_just_started_takes_a_number_above_every_other() -> None:
    epoch = RegistrationEpoch()
    assert epoch.value == 0
    assert epoch.may_overtake(refusal(0, alive=True))
    assert epoch.value == 1
    assert epoch.may_overtake(refusal(4, alive=True))
    assert epoch.value == 5


def test_a_registered_process_stops_if_a_newer_live_one_has_registered() -> None:
    epoch = RegistrationEpoch()
    epoch.note_registered()
    assert not epoch.may_overtake(refusal(1, alive=True))
    assert epoch.value == 0
    assert epoch.may_overtake(refusal(1, alive=False))
    assert epoch.value == 2


def test_only_a_process_with_a_higher_epoch_counts_as_the_newer_one() -> None:
    """A directory that was restored from a backup may know an older process only."""
    epoch = RegistrationEpoch()
    epoch.may_overtake(refusal(3, alive=True))
    error = LeaseExpired("x", metadata={"registration_epoch": "5"})
    assert epoch.is_overtaken(error)
    assert not epoch.is_overtaken(LeaseExpired("x", metadata={"registration_epoch": "3"}))
    assert not epoch.is_overtaken(LeaseExpired("x"))
