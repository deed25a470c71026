"""Queues over gRPC: the parts that the servicer adds to the transitions."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import pytest_asyncio

from stampede_rt.v1 import directory_pb2, queue_pb2
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import peer_service_pb2 as peers_pb
from stampede_rt.v1 import queue_directory_service_pb2 as pb
from tests.support.supernode.memory_log import ProposalOutcome
from tests.support.supernode.node import Node, reason_of, running_node
from tests.support.supernode.operations import id_of


@pytest_asyncio.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        await node.register(1, name="one")
        await node.register(2, name="two")
        yield node


def open_request(number: int, name: str, *, create: bool = True, host: str = "", **spec: Any) -> pb.OpenQueueRequest:
    return pb.OpenQueueRequest(
        request_id=id_of(number), name=name, spec=queue_pb2.QueueSpec(**spec), create=create, host_name=host
    )


def resolve(**key: Any) -> pb.ResolveQueueRequest:
    return pb.ResolveQueueRequest(**key)


async def test_a_queue_is_opened_resolved_changed_listed_and_deleted(node: Node) -> None:
    opened = await node.queues.OpenQueue(open_request(1, "jobs", host="two", max_items=5))
    assert (opened.created, opened.host.name, opened.queue.spec.max_items) == (True, "two", 5)
    by_name = await node.queues.ResolveQueue(resolve(name="jobs"))
    assert by_name == await node.queues.ResolveQueue(resolve(queue_id=opened.queue.queue_id))
    assert (by_name.queue, by_name.host, by_name.applied_index) == (opened.queue, opened.host, node.log.index)
    change = pb.UpdateQueueRequest(
        request_id=id_of(2), queue_id=opened.queue.queue_id, epoch=1, spec=queue_pb2.QueueSpec(copies=2)
    )
    updated = await node.queues.UpdateQueue(change)
    assert (updated.queue.spec.max_items, updated.queue.spec.copies, updated.queue.spec_version) == (5, 2, 2)
    assert await node.queues.UpdateQueue(change) == updated, "the same request id repeats the answer"
    listed = await node.queues.ListQueues(pb.ListQueuesRequest(name_glob="j*"))
    assert (list(listed.queues), list(listed.hosts)) == ([updated.queue], [opened.host])
    gone = pb.DeleteQueueRequest(request_id=id_of(3), queue_id=opened.queue.queue_id)
    await node.queues.DeleteQueue(gone)
    assert (await reason_of(node.queues.ResolveQueue(resolve(name="jobs")))).reason == "QUEUE_NOT_FOUND"


async def test_an_existing_queue_is_opened_without_an_entry_in_the_log(node: Node) -> None:
    first = await node.queues.OpenQueue(open_request(1, "jobs", max_items=5))
    index = node.log.index
    second = await node.queues.OpenQueue(open_request(2, "jobs", create=False))
    assert (second.queue, second.created) == (first.queue, False)
    assert (await reason_of(node.queues.OpenQueue(open_request(3, "jobs", max_items=6)))).reason == "QUEUE_EXISTS"
    assert await node.queues.OpenQueue(open_request(1, "jobs", max_items=5)) == first, (
        "the answer says that the queue was created, as the first answer did"
    )
    assert (await reason_of(node.queues.OpenQueue(open_request(4, "none", create=False)))).reason == "QUEUE_NOT_FOUND"
    assert node.log.index == index


async def test_a_queue_is_created_once_even_if_the_outcome_of_the_first_proposal_is_unknown(node: Node) -> None:
    node.log.outcomes.append(ProposalOutcome.DONE_WITHOUT_ANSWER)
    assert (await node.queues.OpenQueue(open_request(1, "jobs"))).created
    assert len((await node.queues.ListQueues(pb.ListQueuesRequest())).queues) == 1


async def test_a_queue_whose_host_is_lost_gets_another_one_when_it_is_opened(node: Node) -> None:
    before = (await node.queues.OpenQueue(open_request(1, "jobs", host="one"))).queue
    for _ in range(6):
        await node.renew(2)
        await node.pass_seconds(1)
    found = await node.queues.ResolveQueue(resolve(name="jobs"))
    assert (found.host.alive, found.queue) == (False, before)
    after = (await node.queues.OpenQueue(open_request(2, "jobs"))).queue
    assert (after.host_id, after.epoch, after.queue_id) == (id_of(2), 2, before.queue_id)
    assert after.incarnation != before.incarnation


async def test_a_host_gets_its_queues_when_it_registers_again(node: Node) -> None:
    before = (await node.queues.OpenQueue(open_request(1, "jobs", host="one"))).queue
    assert list((await node.register(1, name="one")).queues) == [before]
    (after,) = (await node.register(1, name="one", boot=2)).queues
    assert after.epoch == 2
    assert after.incarnation != before.incarnation


async def test_queues_and_mailboxes_are_listed_page_by_page_and_a_token_belongs_to_its_listing(node: Node) -> None:
    for number, name in enumerate(("b", "a", "c"), start=1):
        await node.queues.OpenQueue(open_request(number, name))
    for number, name in enumerate(("z", "y"), start=1):
        entering = peers_pb.RegisterPeerRequest(
            request_id=id_of(10 + number), peer_id=id_of(20 + number), name=name, boot_incarnation=1
        )
        await node.peers.RegisterPeer(entering)
    pages: list[pb.ListQueuesResponse] = []
    token = ""
    while token or not pages:
        ask = pb.ListQueuesRequest(include_mailboxes=True, page_size=2, page_token=token)
        pages.append(await node.queues.ListQueues(ask))
        token = pages[-1].next_page_token
    shown = [queue.name or queue.mailbox_peer_id for page in pages for queue in page.queues]
    assert shown == ["a", "b", "c", id_of(22), id_of(21)]
    assert [len(page.queues) for page in pages] == [2, 2, 1]
    ask = pb.ListQueuesRequest(page_token=pages[0].next_page_token)
    error = await reason_of(node.queues.ListQueues(ask))
    assert (error.reason, "another listing" in error.message) == ("INVALID_ARGUMENT", True)


async def test_without_a_majority_only_stale_reads_answer(node: Node) -> None:
    await node.queues.OpenQueue(open_request(1, "jobs"))
    node.log.quorum = False
    assert (await reason_of(node.queues.ResolveQueue(resolve(name="jobs"), timeout=0.4))).reason == "NO_QUORUM"
    assert (await node.queues.ResolveQueue(resolve(name="jobs", stale_ok=True))).queue.name == "jobs"


async def test_a_watch_brings_queues_only_if_asked_for_and_mailboxes_only_without_a_pattern(node: Node) -> None:
    requested_watch = node.stub.Watch(directory_pb.WatchRequest(include_queues=True))
    by_name = node.stub.Watch(directory_pb.WatchRequest(name_glob="j*", include_queues=True))
    unasked = node.stub.Watch(directory_pb.WatchRequest())
    for watch in (requested_watch, by_name, unasked):
        await watch.read()
    entering = peers_pb.RegisterPeerRequest(request_id=id_of(1), peer_id=id_of(7), name="me", boot_incarnation=1)
    mailbox = (await node.peers.RegisterPeer(entering)).mailbox
    queue = (await node.queues.OpenQueue(open_request(2, "jobs"))).queue
    channel = (await node.open("jet")).channel
    seen = [change async for change in _changes(requested_watch, 3)]
    assert [seen[0].queue, seen[1].queue, seen[2].channel] == [mailbox, queue, channel]
    assert seen[0].kind == directory_pb2.CHANGE_KIND_ADDED
    assert [change.index async for change in _changes(by_name, 2)] == [seen[1].index, seen[2].index]
    assert [change.channel async for change in _changes(unasked, 1)] == [channel]
    for watch in (requested_watch, by_name, unasked):
        watch.cancel()


async def _changes(watch: Any, count: int) -> AsyncIterator[directory_pb2.DirectoryChange]:
    while count > 0:
        for change in (await watch.read()).changes:
            count -= 1
            yield change


async def test_an_unknown_value_of_on_full_is_refused(node: Node) -> None:
    request = open_request(1, "jobs")
    request.spec.on_full = 9  # type: ignore[assignment]
    error = await reason_of(node.queues.OpenQueue(request))
    assert (error.reason, "on_full" in error.message) == ("INVALID_ARGUMENT", True)
