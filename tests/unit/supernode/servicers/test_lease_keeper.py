"""Leases from end to end: RPCs, the leader's table, and the entries of the log. With a manual clock."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from stampede_rt_supernode.core.kept_answers import MARKS_KEPT
from stampede_rt_supernode.servicers import lease_keeper
from tests.support.supernode.memory_log import OTHER, ProposalOutcome
from tests.support.supernode.node import Node, reason_of, running_node


@pytest_asyncio.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        await node.register(1)
        yield node


async def test_a_lease_lasts_only_while_it_is_renewed(node: Node) -> None:
    for _ in range(4):
        await node.pass_seconds(3)
        assert (await node.renew(1)).tenure == 1
    await node.pass_seconds(4)
    assert (await node.host(1)).alive
    await node.pass_seconds(2)
    assert not (await node.host(1)).alive
    assert (await reason_of(node.renew(1))).reason == "LEASE_EXPIRED"


async def test_a_host_whose_lease_ended_keeps_its_channels_until_a_caller_opens_them(node: Node) -> None:
    opened = await node.open("cam")
    await node.pass_seconds(6)
    assert not (await node.host(1)).alive
    reregistered = await node.register(1)
    assert reregistered.channels[0] == opened.channel
    await node.pass_seconds(4)
    assert (await node.renew(1)).tenure == 1


async def test_a_renewal_under_another_boot_incarnation_is_refused(node: Node) -> None:
    error = await reason_of(node.renew(1, boot=2))
    assert error.reason == "LEASE_EXPIRED"
    assert "data folder" in error.message


async def test_a_host_renews_no_registration_that_it_does_not_know(node: Node) -> None:
    """The lease has ended, and another host has a channel. Then an old request registers the host, which has
    not learned of the end of its lease. In an earlier version, its next renewal succeeded, and both hosts served the
    channel.
    """
    known = await node.register(1)
    await node.open("cam")
    await node.register(2)
    await node.pass_seconds(4)
    await node.renew(2)
    await node.pass_seconds(3)
    assert not (await node.host(1)).alive
    assert (await node.open("cam")).host.name == "host-2"
    late = await node.register(1)
    error = await reason_of(node.renew(1, registered_index=known.registered_index))
    assert error.reason == "LEASE_EXPIRED"
    assert "register it again" in error.message
    await node.renew(1, registered_index=late.registered_index)


async def test_a_follower_names_the_leader(node: Node) -> None:
    node.log.leader_id = OTHER.member_id
    error = await reason_of(node.renew(1))
    assert error.reason == "NOT_LEADER"
    assert error.metadata["leader_endpoint"] == OTHER.address
    node.log.leader_id = None
    assert (await reason_of(node.renew(1))).reason == "NO_QUORUM"


async def test_a_leader_grants_nothing_before_its_tenure_is_committed(node: Node) -> None:
    node.log.tenure = 2
    assert (await reason_of(node.renew(1))).reason == "NO_QUORUM"
    await node.leases.tick()
    assert (await node.renew(1)).tenure == 2


async def test_a_new_tenure_grants_every_lease_its_full_ttl(node: Node) -> None:
    await node.pass_seconds(4)
    node.log.tenure = 2
    await node.leases.tick()
    await node.pass_seconds(4)
    assert (await node.host(1)).alive
    await node.pass_seconds(2)
    assert not (await node.host(1)).alive


async def test_a_follower_ends_no_lease(node: Node) -> None:
    node.log.leader_id = OTHER.member_id
    await node.pass_seconds(60)
    assert (await node.host(1)).alive


async def test_a_renewal_is_acknowledged_only_after_a_read_confirmed_since(node: Node) -> None:
    node.log.reads_may_end.clear()
    node.log.read_waits.clear()
    renewal = asyncio.ensure_future(node.renew(1))
    await node.log.read_waits.wait()
    assert not renewal.done()
    node.log.reads_may_end.set()
    assert (await renewal).tenure == 1


async def test_a_leader_that_is_replaced_during_a_confirmed_read_acknowledges_no_renewal(node: Node) -> None:
    node.log.reads_may_end.clear()
    node.log.read_waits.clear()
    renewal = asyncio.ensure_future(node.renew(1))
    await node.log.read_waits.wait()
    node.log.tenure = 2
    await node.leases.tick()
    node.log.reads_may_end.set()
    assert (await reason_of(renewal)).reason == "NO_QUORUM"


async def test_a_lease_whose_end_is_proposed_cannot_be_renewed_even_if_the_proposal_fails(node: Node) -> None:
    await node.pass_seconds(4)
    node.log.outcomes.append(ProposalOutcome.REFUSED)
    node.clock.advance(2 * 10**9)
    ending = asyncio.ensure_future(node.leases.tick())
    await node.log.outcome_met.wait()
    error = await reason_of(node.renew(1))
    assert error.reason == "LEASE_EXPIRED"
    await ending


async def test_a_failure_to_take_over_is_tried_again(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lease_keeper, "PROPOSAL_SECONDS", 0.01)
    node.log.tenure = 2
    node.log.quorum = False
    await node.leases.tick()
    node.log.quorum = True
    await node.leases.tick()
    assert (await node.renew(1)).tenure == 2


async def test_a_leader_writes_time_marks_as_long_as_answers_are_kept(node: Node) -> None:
    def marks() -> tuple[int, int]:
        return node.replica.read(lambda directory: (len(directory.kept_answers.marks), len(directory.kept_answers)))

    await node.pass_seconds(9)
    assert marks() == (0, 3)  # the answers about the tenure, the host and the end of its lease
    await node.pass_seconds(11)
    assert marks()[0] == 1
    await node.pass_seconds(10 * MARKS_KEPT + 10)
    assert marks() == (MARKS_KEPT, 0)
    index = node.replica.read(lambda directory: directory.applied_index)
    await node.pass_seconds(60)
    assert node.replica.read(lambda directory: directory.applied_index) == index


async def test_a_new_leader_writes_its_first_time_mark_after_a_whole_interval(node: Node) -> None:
    await node.pass_seconds(9)
    node.log.tenure = 2
    await node.leases.tick()
    await node.pass_seconds(9)
    assert node.replica.read(lambda directory: directory.kept_answers.marks) == ()
    await node.pass_seconds(2)
    assert len(node.replica.read(lambda directory: directory.kept_answers.marks)) == 1
