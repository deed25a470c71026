"""Draws operations on queues and peers for the property tests. There are few ids, so many operations share one."""

from __future__ import annotations

from hypothesis import strategies as st

from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.peers.commands import DeregisterPeer, ExpirePeers, PeerLease, RegisterPeer
from stampede_rt_supernode.core.queues.commands import DeleteQueue, OpenQueue, UpdateQueue
from stampede_rt_supernode.core.records import QueueRecord, QueueSpec
from tests.support.supernode.operations import id_of

peer_ids = st.integers(11, 13).map(id_of)
peer_names = st.sampled_from(["p", "p", "p", "q", "q", "q/r", "", "", "-"])
boots = st.sampled_from([1, 1, 2])
proofs = st.sampled_from([b"", b"", b"1" * 32, b"2" * 32])
host_names = st.sampled_from(["", "", "", "a", "b", "none"])
incarnations = st.sampled_from([1, 2, 3, 2**64 - 1])


def some_queue(directory: Directory, number: int) -> QueueRecord | None:
    queues = directory.tables.queues.by_id
    return queues[sorted(queues)[number % len(queues)]] if queues else None


@st.composite
def queue_specs(draw: st.DrawFn, directory: Directory) -> QueueSpec:
    dead_letter = draw(st.sampled_from([None, None, None, 0, 1, 2, 3, 99]))
    held = None if dead_letter is None else some_queue(directory, dead_letter)
    return QueueSpec(
        max_items=draw(st.sampled_from([None, None, None, 1, 2, 0])),
        copies=draw(st.sampled_from([None, None, 1, 2])),
        on_full=draw(st.sampled_from([None, None, "block", "reject"])),
        dead_letter_queue_id=held.queue_id if held is not None and dead_letter != 99 else None,
    )


@st.composite
def queue_operations(
    draw: st.DrawFn, directory: Directory, new_queue_id: bytes
) -> OpenQueue | UpdateQueue | DeleteQueue:
    what = draw(st.integers(0, 5))
    if what <= 2:
        return OpenQueue(
            name=draw(st.sampled_from(["x", "y", "z", "-"])),
            spec=draw(queue_specs(directory)),
            create=draw(st.sampled_from([True, True, False])),
            host_name=draw(host_names),
            new_queue_id=new_queue_id,
            new_incarnation=draw(incarnations),
        )
    queue = some_queue(directory, draw(st.integers(0, 5)))
    queue_id, epoch = (queue.queue_id, queue.epoch) if queue else (id_of(9996), 1)
    if what == 5:
        return DeleteQueue(queue_id=queue_id)
    epoch += draw(st.sampled_from([0, 0, 0, 1]))
    return UpdateQueue(queue_id=queue_id, epoch=epoch, spec=draw(queue_specs(directory)))


@st.composite
def registrations(draw: st.DrawFn, directory: Directory, new_mailbox_id: bytes) -> RegisterPeer:
    name = draw(peer_names)
    return RegisterPeer(
        peer_id=draw(peer_ids),
        name=name,
        boot_incarnation=draw(boots),
        proof_sha256=draw(proofs),
        mailbox=draw(st.none() | queue_specs(directory)) if name else None,
        mailbox_host_name=draw(host_names) if name else "",
        host_id=draw(st.sampled_from([None, None, None, None, None, id_of(1), id_of(9)])),
        attributes=draw(st.sampled_from([(), (("role", "driver"),)])),
        new_mailbox_id=new_mailbox_id,
        new_incarnation=draw(incarnations),
        registration_epoch=draw(st.integers(0, 3)),
    )


@st.composite
def endings(draw: st.DrawFn, directory: Directory) -> DeregisterPeer | ExpirePeers:
    if draw(st.booleans()):
        return DeregisterPeer(peer_id=draw(peer_ids), boot_incarnation=draw(st.sampled_from([1, 1, 2])))
    leases = []
    for peer_id in draw(st.lists(peer_ids, min_size=1, max_size=3)):
        held = directory.tables.peers.by_id.get(peer_id)
        boot, index = (held.boot_incarnation, held.registered_index) if held else (1, 1)
        late = draw(st.sampled_from([0, 0, 0, 1]))
        leases.append(PeerLease(peer_id=peer_id, boot_incarnation=boot, registered_index=index - late))
    return ExpirePeers(leases=tuple(leases), tenure=directory.tenure + draw(st.sampled_from([0, 0, 0, 1])))
