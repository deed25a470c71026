"""The leader's lease table, on a manual clock in seconds."""

from dataclasses import replace
from itertools import pairwise

import pytest

from stampede_rt.values.peering import ClockOffset
from stampede_rt_supernode.core.lease import LEASE_TTL_NANOS, LOOKS_MAX, LeaseTable
from stampede_rt_supernode.core.records import HostRecord

SECOND = 10**9
TTL = LEASE_TTL_NANOS


def host(number: int, *, registered_index: int = 1, boot: int = 1) -> HostRecord:
    return HostRecord(
        host_id=bytes([number]),
        name=f"h{number}",
        gatekeepers=(),
        boot_incarnation=boot,
        version="",
        alive=True,
        channels=0,
        registered_index=registered_index,
    )


@pytest.fixture
def table() -> LeaseTable:
    table = LeaseTable()
    table.lead(7, [host(1), host(2)], 0, ttl_nanos=TTL)
    return table


def pass_time(table: LeaseTable, start: int, end: int) -> list[tuple[bytes, int, int]]:
    """The due leases at `end`, for a leader that looks every second."""
    due: list[tuple[bytes, int, int]] = []
    for now in range(start, end + 1, SECOND):
        due = table.due(now)
    return due


def test_a_new_leader_grants_every_lease_its_full_ttl(table: LeaseTable) -> None:
    assert pass_time(table, 0, TTL - SECOND) == []
    assert table.due(TTL - 1) == []
    assert table.due(TTL) == [(b"\x01", 1, 1), (b"\x02", 1, 1)]


def test_a_renewal_extends_a_lease_by_a_ttl_from_its_receipt(table: LeaseTable) -> None:
    assert table.renew(host(1), 3 * SECOND)
    assert pass_time(table, 0, TTL) == [(b"\x02", 1, 1)]
    table.follow([host(1)], TTL)
    assert pass_time(table, TTL, 3 * SECOND + TTL - SECOND) == []
    assert table.due(3 * SECOND + TTL) == [(b"\x01", 1, 1)]


def test_a_renewal_received_earlier_does_not_shorten_the_lease(table: LeaseTable) -> None:
    assert table.renew(host(1), 3 * SECOND)
    assert table.renew(host(1), 1 * SECOND)
    assert pass_time(table, 0, TTL + SECOND) == [(b"\x02", 1, 1)]


def test_a_leader_refuses_to_renew_a_lease_whose_end_is_proposed_and_repeats_the_proposal(
    table: LeaseTable,
) -> None:
    assert len(pass_time(table, 0, TTL)) == 2
    assert not table.renew(host(1), TTL)
    assert len(table.due(TTL + 1)) == 2


def test_a_new_registration_gets_a_lease_of_its_own(table: LeaseTable) -> None:
    pass_time(table, 0, TTL)
    reregistered = host(1, registered_index=9)
    assert table.renew(reregistered, TTL)
    assert table.due(TTL + 1) == [(b"\x02", 1, 1)]


def test_a_registration_seen_by_the_leader_gets_a_full_ttl_from_then(table: LeaseTable) -> None:
    table.follow([host(1), host(2), host(3, registered_index=8)], 4 * SECOND)
    assert pass_time(table, 0, TTL) == [(b"\x01", 1, 1), (b"\x02", 1, 1)]
    table.follow([host(3, registered_index=8)], TTL)
    assert pass_time(table, TTL, 8 * SECOND) == []
    assert table.due(9 * SECOND) == [(b"\x03", 1, 8)]


def test_a_leader_that_was_paused_ends_no_lease_because_of_its_pause(table: LeaseTable) -> None:
    pass_time(table, 0, 2 * SECOND)
    frozen_until = 60 * SECOND
    assert table.due(frozen_until) == []
    assert pass_time(table, frozen_until, frozen_until + TTL - SECOND) == []
    assert len(table.due(frozen_until + TTL)) == 2


def test_a_pause_of_the_leader_does_not_cancel_the_proposed_end_of_a_lease(table: LeaseTable) -> None:
    pass_time(table, 0, TTL)
    assert len(table.due(60 * SECOND)) == 2


def test_a_supernode_that_leads_again_grants_a_full_ttl(table: LeaseTable) -> None:
    pass_time(table, 0, 4 * SECOND)
    table.lead(9, [host(1), host(2)], 4 * SECOND, ttl_nanos=TTL)
    assert pass_time(table, 4 * SECOND, 8 * SECOND) == []
    assert len(table.due(9 * SECOND)) == 2


def test_nothing_is_granted_or_ended_without_a_tenure(table: LeaseTable) -> None:
    table.resign()
    assert table.tenure == 0
    table.follow([replace(host(1))], 0)
    assert table.due(100 * SECOND) == []


AHEAD = ClockOffset(offset_nanos=7, uncertainty_nanos=1, supernode="s1")


def test_the_last_clock_reading_of_a_holder_is_kept_beside_its_lease(table: LeaseTable) -> None:
    assert table.clock(host(1)) is None
    assert table.renew(host(1), SECOND, AHEAD)
    assert (table.clock(host(1)), table.clock(host(2)), table.clock(host(3))) == (AHEAD, None, None)
    assert table.renew(host(1), 2 * SECOND)  # the holder does not know its offset any more
    assert table.clock(host(1)) is None
    table.note_clock(host(1), AHEAD, 3 * SECOND)
    assert table.clock(host(1, registered_index=9)) is None  # another registration, which the table does not know
    table.follow([], 4 * SECOND)
    assert table.clock(host(1)) is None


def test_a_clock_reading_with_a_registration_does_not_extend_a_known_lease(table: LeaseTable) -> None:
    table.note_clock(host(1), AHEAD, 3 * SECOND)
    assert (b"\x01", 1, 1) in pass_time(table, 0, TTL)


def test_clock_readings_are_noted_only_during_a_tenure_and_end_with_it(table: LeaseTable) -> None:
    table.note_clock(host(1), AHEAD, SECOND)
    table.lead(8, [host(1)], SECOND, ttl_nanos=TTL)
    assert table.clock(host(1)) is None
    table.resign()
    table.note_clock(host(1), AHEAD, SECOND)
    assert table.clock(host(1)) is None


class CountedHolder:
    """A registration; `seen` counts how often a table has looked at any of these registrations."""

    boot_incarnation = 1
    registered_index = 1
    seen = 0

    def __init__(self, number: int) -> None:
        self._id = number.to_bytes(4)

    @property
    def holder_id(self) -> bytes:
        CountedHolder.seen += 1
        return self._id


def test_very_many_leases_are_looked_at_and_ended_a_part_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, each look at 100,000 leases took 25 ms, and an update of their holders took 107 ms."""
    looks, count = 0, 5 * LOOKS_MAX
    look = LeaseTable._look

    def counted(table: LeaseTable, now: int) -> None:
        nonlocal looks
        looks += 1
        look(table, now)

    monkeypatch.setattr(LeaseTable, "_look", counted)
    table = LeaseTable()
    table.lead(7, [], 0, ttl_nanos=TTL)
    holders = [CountedHolder(number) for number in range(count)]
    before = 0
    for _ in table.following(holders, 1, 0):
        assert CountedHolder.seen - before <= 4 * LOOKS_MAX
        before = CountedHolder.seen
    assert pass_time(table, 0, TTL - SECOND) == []
    assert looks == 0, "none of the leases can be due"
    ended: set[bytes] = set()
    while due := table.due(TTL):
        assert looks <= LOOKS_MAX
        assert len(due) <= LOOKS_MAX
        looks = 0
        ended.update(holder_id for holder_id, _, _ in due)
        for holder_id, _, _ in due:
            table.note_gone(holder_id, 2)
    assert len(ended) == count


def test_a_holder_that_has_registered_again_keeps_its_lease(table: LeaseTable) -> None:
    reregistered = host(1, registered_index=9)
    assert table.renew(reregistered, TTL)
    table.note_gone(reregistered.host_id, 8)
    table.note(host(1), TTL)
    assert table.due(2 * TTL - 1) == []  # all other leases got a full TTL, because the leader had not looked
    assert (reregistered.host_id, 1, 9) in pass_time(table, 2 * TTL - 1, 4 * TTL)
    table.note_gone(reregistered.host_id, 8)
    assert not table.renew(reregistered, 4 * TTL), "the leader has proposed the lease's end"


def test_a_leader_that_resigns_frees_its_leases_in_pieces() -> None:
    table, count = LeaseTable(), 5 * LOOKS_MAX
    hosts = [replace(host(1), host_id=number.to_bytes(4)) for number in range(count)]
    table.lead(7, hosts, 0, ttl_nanos=TTL)
    table.resign()
    assert table.due(2 * TTL) == []
    kept = [count]
    for _ in table.freeing():
        kept.append(sum(len(leases) for leases, _ in table._forgotten))
    assert max(before - after for before, after in pairwise(kept)) <= LOOKS_MAX
    assert kept[-1] == 0
    assert not table._forgotten
