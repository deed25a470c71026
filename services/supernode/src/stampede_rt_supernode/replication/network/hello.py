"""The hellos by which members introduce themselves, and the reasons to refuse a hello. Without I/O."""

from __future__ import annotations

from typing import NamedTuple

import grpc

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.interface import Member, too_old
from stampede_rt_supernode.replication.raft_replica import MemberRoster
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION, ReplicationSettings
from stampede_rt_supernode.replication.storage.known_stores import STORE_ID_BYTES_MAX, KnownStores
from stampede_rt_supernode.replication.storage.store import Promise
from stampede_rt_supernode.replication.wire.records import ADDRESS_BYTES_MAX, MEMBER_ID_BYTES_MAX

# The words that refuse a member that was removed from the cluster.
REMOVED = "was removed from this cluster"
# The words that refuse a member that came with another store before, or that had a store and has none now.
ANOTHER_STORE = "has come with another store before"
# The words that refuse a member whose store lacks data that the member has reported before (see `store.Promise`).
OLDER_STORE = "comes with an older copy of its store"
# The words that refuse a member without a store, while the others have stores.
NO_STORE = "has no store, but the others have stores"
# The words that refuse a member of another cluster.
OTHER_CLUSTER = "is of another cluster"
# The words that refuse an unknown caller. A member that has just joined is unknown until this member learns of it.
UNKNOWN = "is no other member of this cluster"


class HelloRefusal(NamedTuple):
    """The reason why a hello is refused.

    `sends_members`: the caller still gets the list of members, because it may be a new member
    that this member does not know yet.
    """

    code: grpc.StatusCode
    why: str
    sends_members: bool = False


def introduction(
    settings: ReplicationSettings,
    to: str,
    *,
    store_id: str,
    durable_end: tuple[int, int],
    roster: MemberRoster,
    highest_level: int,
) -> pb.RaftHello:
    """The hello of this member to the member `to`. `durable_end`: the term and last log index on this member's disk."""
    own = settings.self_member
    is_member = any(member.member_id == own.member_id for member in roster.members)
    return pb.RaftHello(
        cluster_id=settings.cluster_id,
        member_id=own.member_id,
        peer_member_id=to,
        protocol_version=PROTOCOL_VERSION,
        store_id=store_id,
        term=durable_end[0],
        last_log_index=durable_end[1],
        address=own.address if is_member else "",
        highest_feature_level=highest_level,
    )


def refusal_of(
    hello: pb.RaftHello,
    settings: ReplicationSettings,
    *,
    roster: MemberRoster,
    stores: KnownStores,
    promise: Promise,
    feature_level: int,
) -> HelloRefusal | None:
    """The reason why this member refuses the caller's hello; None if it accepts.

    `promise`: the data that the caller's store must hold, by its earlier reports.
    """
    failed, denied = grpc.StatusCode.FAILED_PRECONDITION, grpc.StatusCode.PERMISSION_DENIED
    own, caller = settings.self_member.member_id, hello.member_id
    names = [(name, MEMBER_ID_BYTES_MAX) for name in (caller, hello.peer_member_id, hello.cluster_id)]
    sizes = *names, (hello.address, ADDRESS_BYTES_MAX), (hello.store_id, STORE_ID_BYTES_MAX)
    if not caller or any(len(text.encode()) > limit for text, limit in sizes):
        return HelloRefusal(grpc.StatusCode.INVALID_ARGUMENT, "a hello without an id, or with a text that is too long")
    if hello.protocol_version != PROTOCOL_VERSION:
        return HelloRefusal(failed, other_protocol(own, hello.protocol_version))
    if hello.cluster_id != settings.cluster_id:
        return HelloRefusal(
            failed, f"this member {OTHER_CLUSTER}, {settings.cluster_id!r} and not {hello.cluster_id!r}"
        )
    if hello.peer_member_id != own:
        return HelloRefusal(failed, f"this is member {own!r}, not {hello.peer_member_id!r}")
    if caller in roster.former_ids:
        return HelloRefusal(denied, f"{caller!r} {REMOVED}")
    if hello.highest_feature_level < feature_level:
        return HelloRefusal(failed, too_old(caller, hello.highest_feature_level, feature_level))
    if not stores.admits(caller, hello.store_id):
        return HelloRefusal(denied, f"{caller!r} {ANOTHER_STORE}{'' if hello.store_id else ', and has no store now'}")
    if stores.own and not hello.store_id:
        return HelloRefusal(denied, f"{caller!r} {NO_STORE}; start it with its --data-dir")
    if hello.store_id and not promise.is_kept_by(hello.term, hello.last_log_index):
        held, has = f"term {promise.term} and entry {promise.held}", f"{hello.term} and {hello.last_log_index}"
        return HelloRefusal(denied, f"{caller!r} {OLDER_STORE}: it held {held} before, and holds {has} now")
    if caller not in roster.peers:
        return HelloRefusal(denied, f"{caller!r} {UNKNOWN}", sends_members=True)
    return None


def other_protocol(member_id: str, version: int) -> str:
    """The reason why two members cannot talk: they use different versions of the protocol, PROTOCOL_VERSION and
    `version`.
    """
    return (
        f"{member_id!r} speaks version {PROTOCOL_VERSION} of the log's protocol, not {version}: stop all supernodes, "
        "and start them with one release and the same folders (runbook: upgrade)"
    )


def introduced_member(hello: pb.RaftHello, settings: ReplicationSettings) -> Member | None:
    """The id and address that an unknown caller states in its hello; None without an address or a cluster id.

    A member that was down while the others were replaced knows none of them, but must accept the leader's messages
    (Ongaro's dissertation, section 4.1). A cluster without an id cannot be distinguished from another cluster.
    """
    if not (settings.cluster_id and hello.address):
        return None
    return Member(member_id=hello.member_id, address=hello.address)
