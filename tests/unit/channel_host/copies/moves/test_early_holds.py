"""A host remembers slow sources for a while. Meanwhile they may not hold a channel early."""

from __future__ import annotations

from stampede_rt_channel_host.copies.moves.early_holds import HOSTS_MAX, REMEMBERED_SECONDS, SLOW_SECONDS, EarlyHolds


def test_a_source_may_hold_early_until_a_message_was_slow() -> None:
    early = EarlyHolds()
    assert early.may_hold("h1:1", 0.0)
    early.note_wait("h1:1", SLOW_SECONDS, 0.0)
    assert early.may_hold("h1:1", 0.0)
    early.note_wait("h1:1", SLOW_SECONDS * 1.1, 0.0)
    assert not early.may_hold("h1:1", REMEMBERED_SECONDS - 0.1)
    assert early.may_hold("h2:1", 0.0), "only that source was slow"


def test_a_slow_source_may_hold_early_again_after_a_while() -> None:
    early = EarlyHolds()
    early.note_wait("h1:1", SLOW_SECONDS * 8, 10.0)
    assert not early.may_hold("h1:1", 10.0 + REMEMBERED_SECONDS - 0.1)
    assert early.may_hold("h1:1", 10.0 + REMEMBERED_SECONDS)


def test_the_number_of_remembered_hosts_has_a_bound() -> None:
    early = EarlyHolds()
    for number in range(HOSTS_MAX + 1):
        early.note_wait(f"h{number}:1", SLOW_SECONDS * 8, 0.0)
    assert early.may_hold("h0:1", 1.0)
    assert not early.may_hold("h1:1", 1.0)
