"""The waits for replicas end with the lease of their owner, and begin again if the owner has renewed it."""

from __future__ import annotations

import asyncio

import pytest

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_channel_host.channels.owned_replicas import SAME_TURN_WRITES_MAX, OwnedReplicas
from stampede_rt_channel_host.core.replication import KnownReplica, ReplicasInSync

REPLICA, OTHER, START, NEXT = b"r" * 16, b"o" * 16, 5, 6
FENCED = Unavailable("the host could not renew its lease in time")


class Feed:
    """A feed that sends nothing. It ends if the owner takes something back."""

    ended: StampedeError | None = None

    def __init__(self, replicas: Replicas, host_id: bytes) -> None:
        self._replicas, self._host_id = replicas, host_id

    def wake(self) -> None:
        pass

    def take_back(self) -> None:
        self._replicas.discard(self._host_id, self)

    def end(self, error: StampedeError) -> None:
        self.ended = error


class Replicas(OwnedReplicas[Feed]):
    """The replicas of a thing without readers."""

    def __init__(self) -> None:
        super().__init__(ReplicasInSync(START, 1), 1, lambda: 0)
        self._in_sync.put(NEXT)
        self._feeds[REPLICA] = self.feed = Feed(self, REPLICA)

    def release_replicated(self) -> None:
        self.wake_waits()

    def join(self) -> None:
        """The replica has everything, and the directory's log has its in-sync flag."""
        self.report(REPLICA, self.feed, NEXT)
        for change in self.changes():
            self.confirm(change)


async def test_a_replica_may_begin_anew_at_an_owner_that_renewed_its_lease_late() -> None:
    replicas = Replicas()
    replicas.end(FENCED)
    replicas.know([KnownReplica(REPLICA, 1, False)])
    assert await replicas.begin_anew(REPLICA)


def test_a_replica_without_its_flag_in_the_directory_counts_no_more() -> None:
    """A caller has removed the replica and added it again. In an earlier version the owner acknowledged puts as before,
    although this replica could not become the owner.
    """
    replicas = Replicas()
    replicas.know([KnownReplica(REPLICA, 1, False)])
    replicas.join()
    assert replicas.copies(NEXT) == 2
    replicas.know([KnownReplica(REPLICA, 1, False)])
    assert replicas.copies(NEXT) == 1
    replicas.join()
    assert replicas.copies(NEXT) == 1, "the log has cleared the flag once more"
    replicas.join()
    assert replicas.copies(NEXT) == 2


@pytest.mark.parametrize("before", [[KnownReplica(REPLICA, 1, False, 7)], []], ids=["added again", "listed late"])
def test_a_late_report_does_not_count_for_a_replica_that_was_added_after_the_feed_had_begun(
    before: list[KnownReplica],
) -> None:
    """The directory had removed the replica, and its host has dropped all items. In an earlier version the new replica
    came in sync.
    """
    replicas = Replicas()
    replicas.know(before)
    replicas.know([KnownReplica(REPLICA, 1, False, 8)])
    replicas.join()
    assert replicas.copies(NEXT) == 1
    assert not replicas.is_fed(REPLICA)
    assert replicas.feed.ended is not None


def test_the_feed_of_a_removed_replica_ends() -> None:
    replicas = Replicas()
    replicas.know([KnownReplica(REPLICA, 1, False)])
    replicas.know([KnownReplica(REPLICA, 1, False)])
    assert replicas.is_fed(REPLICA)
    replicas.know([])
    assert not replicas.is_fed(REPLICA)
    assert replicas.feed.ended is not None


def test_the_owner_waits_for_a_replica_that_has_a_flag_of_which_the_owner_did_not_know() -> None:
    """Another owner has set the flag. In an earlier version, the owner acknowledged puts that the replica lacked, and
    this replica could become the owner.
    """
    replicas = Replicas()
    replicas.know([KnownReplica(REPLICA, 1, False), KnownReplica(OTHER, 1, False)])
    replicas.join()
    replicas.know([KnownReplica(REPLICA, 1, True), KnownReplica(OTHER, 1, True)])
    replicas._in_sync.put(NEXT + 1)
    replicas.report(REPLICA, replicas.feed, NEXT + 1)
    assert replicas.replicated_next == NEXT
    (change,) = replicas.changes()
    assert (change.host_id, change.in_sync) == (OTHER, False)
    replicas.confirm(change)
    assert replicas.replicated_next == NEXT + 1


def test_all_feeds_end_that_have_sent_something_which_the_owner_could_not_store() -> None:
    """In an earlier version, only one of the feeds ended."""
    replicas = Replicas()
    other = b"s" * 16
    replicas._feeds[other] = Feed(replicas, other)
    replicas.take_back()
    assert not replicas.is_fed(REPLICA)
    assert not replicas.is_fed(other)


async def test_a_replica_does_not_begin_anew_over_a_break() -> None:
    replicas = Replicas()
    replicas.know([KnownReplica(REPLICA, 1, True)])  # with the in-sync flag, which the directory's log must clear first
    beginning = asyncio.create_task(replicas.begin_anew(REPLICA))
    await asyncio.sleep(0)
    replicas.end(FENCED)
    for change in replicas.changes():
        replicas.confirm(change)
    assert not await beginning


async def test_waits_go_on_after_a_break() -> None:
    replicas = Replicas()
    replicas.know([KnownReplica(REPLICA, 1, False)])
    replicas.end(FENCED)
    waiting = asyncio.create_task(replicas.replicated(NEXT, None))
    await asyncio.sleep(0)
    assert not waiting.done()
    replicas.join()
    assert await waiting


async def test_a_wait_for_a_state_before_a_break_ends_even_if_it_begins_after_the_break() -> None:
    replicas = Replicas()
    replicas.know([KnownReplica(REPLICA, 1, False)])
    period = replicas.period
    waiting = asyncio.create_task(replicas.replicated(NEXT, None))
    await asyncio.sleep(0)
    replicas.end(FENCED)
    assert not await waiting
    assert not await replicas.replicated(NEXT, None, period)
    assert (period.ended, replicas.period.ended) == (FENCED, None)
    replicas.join()
    assert await replicas.replicated(NEXT, None, period)


async def test_a_wait_that_begins_after_the_host_has_given_the_thing_up_ends_immediately() -> None:
    replicas = Replicas()
    replicas.know([KnownReplica(REPLICA, 1, False)])
    replicas.close()
    replicas.end(FENCED)
    period = replicas.period
    async with asyncio.timeout(10):
        assert not await replicas.replicated(NEXT, None, period)
    assert period.ended is FENCED


def test_only_a_few_callers_get_their_answers_in_the_turn_of_a_report() -> None:
    replicas, looks = Replicas(), list[bool]()
    for number in range(SAME_TURN_WRITES_MAX + 5):
        replicas.watch(lambda in_this_turn, _=number: looks.append(in_this_turn))  # type: ignore[misc]
    replicas.report(REPLICA, replicas.feed, NEXT)
    assert looks == [True] * SAME_TURN_WRITES_MAX + [False] * 5
