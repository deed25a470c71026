"""The directory service of a supernode, over gRPC."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable
from typing import Any

import pytest
import pytest_asyncio

from stampede_rt.cluster.request_age import age_metadata
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.servicers import calls, submission
from tests.support.supernode.memory_log import ProposalOutcome
from tests.support.supernode.node import Node, reason_of, running_node, spec
from tests.support.supernode.operations import TTL_NANOS, id_of

BLOCK_FOR_EVER = channel_pb2.ChannelSpec(on_full=channel_pb2.ON_FULL_BLOCK)
LONG_TYPE = channel_pb2.ChannelSpec(content_type="x" * 256)
NO_ROOM = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_bytes=63))


@pytest_asyncio.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        await node.register(1, name="one")
        await node.register(2, name="two")
        yield node


async def test_a_channel_is_opened_resolved_changed_and_deleted(node: Node) -> None:
    opened = await node.open("cam/left", spec=spec(max_items=5), host_name="two")
    assert (opened.created, opened.host.name, opened.host.channels) == (True, "two", 1)
    assert opened.channel.spec == spec(max_items=5)
    by_name = await node.stub.ResolveChannel(pb.ResolveChannelRequest(name="cam/left"))
    by_id = await node.stub.ResolveChannel(pb.ResolveChannelRequest(channel_id=opened.channel.channel_id))
    assert by_name == by_id
    assert by_name.channel == opened.channel
    assert by_name.applied_index == node.log.index
    change = pb.UpdateChannelRequest(
        request_id=id_of(1), channel_id=opened.channel.channel_id, epoch=1, spec=spec(max_age_nanos=9)
    )
    updated = await node.stub.UpdateChannel(change)
    assert updated.channel.spec == spec(max_items=5, max_age_nanos=9)
    await node.stub.DeleteChannel(pb.DeleteChannelRequest(request_id=id_of(2), channel_id=opened.channel.channel_id))
    gone = await reason_of(node.stub.ResolveChannel(pb.ResolveChannelRequest(name="cam/left")))
    assert gone.reason == "CHANNEL_NOT_FOUND"


async def test_a_repeated_update_never_replaces_newer_settings(node: Node) -> None:
    opened = await node.open("cam")

    def update(number: int, max_items: int, age_ms: int = 0) -> Awaitable[pb.UpdateChannelResponse]:
        request = pb.UpdateChannelRequest(
            request_id=id_of(number), channel_id=opened.channel.channel_id, epoch=1, spec=spec(max_items=max_items)
        )
        pending: Awaitable[pb.UpdateChannelResponse] = node.stub.UpdateChannel(
            request, timeout=10, metadata=age_metadata(age_ms / 1000)
        )
        return pending

    async def held() -> int:
        found = await node.stub.ResolveChannel(pb.ResolveChannelRequest(name="cam"))
        return int(found.channel.spec.retention.max_items)

    await update(1, 111)
    await update(2, 222)
    node.log.index += 20_000  # as if the directory had performed that many commands
    await update(1, 111, age_ms=20_000)
    assert await held() == 222
    refused = await reason_of(update(1, 111, age_ms=30_000))
    assert (refused.reason, "first sent 30 s ago" in refused.message) == ("INVALID_ARGUMENT", True)
    for _ in range(10):
        await node.pass_seconds(10)
    assert (await reason_of(update(1, 111, age_ms=100_000))).reason == "INVALID_ARGUMENT"
    assert await held() == 222


async def test_the_second_opener_gets_the_same_channel_without_an_entry_in_the_log(node: Node) -> None:
    first = await node.open("cam", spec=spec(max_items=5))
    index = node.log.index
    second = await node.open("cam")
    assert second.channel == first.channel
    assert not second.created
    refused = await reason_of(node.open("cam", spec=spec(max_items=6)))
    assert refused.reason == "CHANNEL_EXISTS"
    absent = await reason_of(node.open("none", create=False))
    assert absent.reason == "CHANNEL_NOT_FOUND"
    assert node.log.index == index


async def test_a_provisional_channel_takes_on_a_policy_with_an_entry_in_the_log(node: Node) -> None:
    await node.open("cam")
    assert (await node.open("cam", spec=spec(max_items=5))).channel.spec == spec(max_items=5)


async def test_repeating_a_request_id_repeats_the_answer(node: Node) -> None:
    first = await node.open("cam", request_id=id_of(9))
    assert await node.open("cam", request_id=id_of(9)) == first
    assert first.created
    other = await reason_of(node.open("mic", request_id=id_of(9)))
    assert other.reason == "INVALID_ARGUMENT"


@pytest.mark.parametrize("outcome", list(ProposalOutcome))
async def test_an_update_whose_first_proposal_fails_is_performed_once(node: Node, outcome: ProposalOutcome) -> None:
    node.log.outcomes.extend([outcome, outcome])
    opened = await node.open("cam")
    assert opened.created
    assert opened.host.channels == 1


async def test_an_unknown_outcome_is_reported_as_ambiguous(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calls, "ANSWER_SECONDS", 2.0)  # the answer comes within this time on a busy machine, too
    node.log.outcomes.extend([ProposalOutcome.LOST] + [ProposalOutcome.REFUSED] * 1000)
    request = pb.DeleteChannelRequest(request_id=id_of(1), channel_id=id_of(2))
    error = await reason_of(node.stub.DeleteChannel(request, timeout=2.5))
    assert error.reason == "AMBIGUOUS"
    assert "same request id" in error.message


async def test_without_a_majority_updates_and_default_reads_fail_and_stale_reads_are_answered(node: Node) -> None:
    await node.open("cam")
    node.log.quorum = False
    request = pb.DeleteChannelRequest(request_id=id_of(1), channel_id=id_of(2))
    assert (await reason_of(node.stub.DeleteChannel(request, timeout=0.4))).reason == "NO_QUORUM"
    resolve = pb.ResolveChannelRequest(name="cam")
    assert (await reason_of(node.stub.ResolveChannel(resolve, timeout=0.4))).reason == "NO_QUORUM"
    assert (await node.stub.ResolveChannel(pb.ResolveChannelRequest(name="cam", stale_ok=True))).channel.name == "cam"
    listed = await node.stub.ListChannels(pb.ListChannelsRequest(stale_ok=True))
    assert [channel.name for channel in listed.channels] == ["cam"]


async def test_a_failed_proposal_is_repeated_a_bounded_number_of_times(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(submission, "BACKOFF_SECONDS_MIN", 0.1)
    node.log.outcomes.extend([ProposalOutcome.REFUSED] * 1000)
    request = pb.DeleteChannelRequest(request_id=id_of(1), channel_id=id_of(2))
    await reason_of(node.stub.DeleteChannel(request, timeout=0.6))
    assert 1000 - len(node.log.outcomes) < 15


async def test_a_call_that_waits_when_the_supernode_stops_is_sent_to_another(node: Node) -> None:
    node.log.outcomes.extend([ProposalOutcome.REFUSED] * 1000)
    waiting = asyncio.ensure_future(node.open("cam"))
    await node.log.outcome_met.wait()
    node.submission.close()
    assert (await reason_of(waiting)).reason == "SHUTTING_DOWN"


async def test_channels_are_listed_by_pattern_and_page(node: Node) -> None:
    for name in ("cam/a", "cam/b", "cam/c", "mic"):
        await node.open(name)
    first = await node.stub.ListChannels(pb.ListChannelsRequest(name_glob="cam/*", page_size=2))
    second = await node.stub.ListChannels(
        pb.ListChannelsRequest(name_glob="cam/*", page_size=2, page_token=first.next_page_token)
    )
    assert [channel.name for page in (first, second) for channel in page.channels] == ["cam/a", "cam/b", "cam/c"]
    assert second.next_page_token == ""
    assert {host.name for host in first.hosts} == {"one", "two"}


async def test_hosts_are_listed_and_resolved_by_name_and_id(node: Node) -> None:
    listed = await node.stub.ListHosts(pb.ListHostsRequest(page_size=1))
    rest = await node.stub.ListHosts(pb.ListHostsRequest(page_token=listed.next_page_token))
    assert [host.name for host in (*listed.hosts, *rest.hosts)] == ["one", "two"]
    by_name = await node.stub.ResolveHost(pb.ResolveHostRequest(name="two"))
    assert by_name.host == await node.host(2)
    assert (await reason_of(node.stub.ResolveHost(pb.ResolveHostRequest(name="x")))).reason == "HOST_NOT_FOUND"


async def test_registering_answers_with_ttl_cluster_and_the_channels_held_for_the_host(node: Node) -> None:
    await node.open("cam", host_name="one")
    reregistered = await node.register(1, name="one", boot=2)
    assert reregistered.lease_ttl_nanos == TTL_NANOS
    assert reregistered.cluster_id
    assert [(channel.name, channel.epoch) for channel in reregistered.channels] == [("cam", 2)]


async def test_a_host_that_leaves_frees_its_channels_immediately(node: Node) -> None:
    before = await node.open("cam", host_name="one")
    await node.stub.DeregisterHost(pb.DeregisterHostRequest(request_id=id_of(1), host_id=id_of(1), boot_incarnation=1))
    resolved = await node.stub.ResolveChannel(pb.ResolveChannelRequest(name="cam"))
    assert not resolved.host.alive
    after = await node.open("cam")
    assert (after.host.name, after.channel.epoch) == ("two", before.channel.epoch + 1)
    assert after.channel.incarnation != before.channel.incarnation


@pytest.mark.parametrize(
    ("method", "request_"),
    [
        ("OpenChannel", pb.OpenChannelRequest(name="cam", create=True)),
        ("DeleteChannel", pb.DeleteChannelRequest(channel_id=id_of(1))),
        ("UpdateChannel", pb.UpdateChannelRequest(request_id=b"short")),
        ("RegisterHost", pb.RegisterHostRequest(name="x")),
        ("DeregisterHost", pb.DeregisterHostRequest()),
    ],
)
async def test_an_update_without_a_proper_request_id_is_refused(node: Node, method: str, request_: object) -> None:
    error = await reason_of(getattr(node.stub, method)(request_))
    assert error.reason == "INVALID_ARGUMENT"
    assert "request_id" in error.message


@pytest.mark.parametrize(
    ("method", "request_"),
    [
        ("ResolveChannel", pb.ResolveChannelRequest()),
        ("ResolveChannel", pb.ResolveChannelRequest(channel_id=b"short")),
        ("ResolveHost", pb.ResolveHostRequest()),
        ("ListChannels", pb.ListChannelsRequest(page_token="???")),
        ("ListHosts", pb.ListHostsRequest(page_token="???")),
        ("ListChannels", pb.ListChannelsRequest(name_glob="[a]")),
        ("RenewHostLease", pb.RenewHostLeaseRequest()),
        ("OpenChannel", pb.OpenChannelRequest(name="cam", spec=BLOCK_FOR_EVER)),
        ("OpenChannel", pb.OpenChannelRequest(name="cam", host_name="h" * 100_000)),
        ("OpenChannel", pb.OpenChannelRequest(name="c" * 100_000)),
        ("UpdateChannel", pb.UpdateChannelRequest(channel_id=id_of(1), spec=LONG_TYPE)),
        ("OpenChannel", pb.OpenChannelRequest(name="cam", spec=NO_ROOM)),
        ("UpdateChannel", pb.UpdateChannelRequest(channel_id=id_of(1), spec=NO_ROOM)),
        ("UpdateChannel", pb.UpdateChannelRequest(channel_id=b"x" * 100_000)),
        ("DeleteChannel", pb.DeleteChannelRequest(channel_id=b"short")),
        ("RegisterHost", pb.RegisterHostRequest(host_id=id_of(1), name="h", boot_incarnation=1)),
        ("DeregisterHost", pb.DeregisterHostRequest(host_id=b"x" * 100_000)),
    ],
)
async def test_a_request_with_an_unknown_value_gets_invalid_argument(node: Node, method: str, request_: Any) -> None:
    if "request_id" in request_.DESCRIPTOR.fields_by_name:
        request_.request_id = id_of(1)
    if isinstance(request_, pb.OpenChannelRequest):
        request_.create = True
    error = await reason_of(getattr(node.stub, method)(request_))
    assert error.reason in ("INVALID_ARGUMENT", "INVALID_NAME")
    assert node.log.index == 3, "nothing of the request came into the log"


async def test_ping_returns_the_clock_the_id_and_the_readiness_of_the_supernode(node: Node) -> None:
    pong = await node.stub.Ping(pb.DirectoryServicePingRequest())
    assert (pong.time_unix_nano, pong.supernode_id, pong.ready) == (node.clock.time_unix_nano(), "s1", True)
    assert pong.cluster_id
    node.log.leader_id = None
    assert not (await node.stub.Ping(pb.DirectoryServicePingRequest())).ready


async def test_the_members_are_listed_with_their_observed_state(node: Node) -> None:
    await node.probe.round()
    listed = await node.stub.ListSupernodes(pb.ListSupernodesRequest())
    me, other = listed.supernodes
    assert (me.supernode_id, me.endpoint.target, me.endpoint.zone) == ("s1", "rig:7581", "lab")
    assert (me.is_leader, me.healthy) == (True, True)
    assert (other.supernode_id, other.healthy, other.HasField("round_trip_nanos")) == ("s2", False, False)
    assert listed.term == 1


async def test_a_member_that_answers_is_healthy_and_its_round_trip_is_measured(node: Node) -> None:
    node.log.other = Member(member_id="s2", address=node.address)
    await node.probe.round()
    other = (await node.stub.ListSupernodes(pb.ListSupernodesRequest())).supernodes[1]
    assert (other.endpoint.target, other.healthy) == (node.address, True)
    assert other.round_trip_nanos > 0
    node.log.other = Member(member_id="s3", address="localhost:1")
    await node.probe.round()
    assert not (await node.stub.ListSupernodes(pb.ListSupernodesRequest())).supernodes[1].healthy
