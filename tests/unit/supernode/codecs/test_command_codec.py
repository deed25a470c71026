"""Commands and results are the same after encoding and decoding."""

from dataclasses import replace
from typing import Any

import pytest

from stampede_rt.errors import StampedeError, VersionMismatch
from stampede_rt.v1 import channel_pb2, directory_command_pb2
from stampede_rt.values.model import Policy
from stampede_rt_runtime.access.rules import AccessKind, AccessRule, AccessVerb
from stampede_rt_runtime.quotas.limits import LIMIT_MAX, Quota, QuotaSetting
from stampede_rt_supernode.codecs.command_codec import (
    CODECS,
    decode_command,
    decode_result,
    encode_command,
    encode_result,
)
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.access.commands import (
    AccessRuleAdded,
    AccessRuleRemoved,
    AddAccessRule,
    CreateTokenKey,
    CredentialRevoked,
    RemoveAccessRule,
    RevokeCredential,
    TokenKeyCreated,
)
from stampede_rt_supernode.core.access.quota_commands import QuotasRemoved, QuotasSet, RemoveQuotas, SetQuotas
from stampede_rt_supernode.core.channels.commands import ChannelDeleted, ChannelOpened, ChannelUpdated
from stampede_rt_supernode.core.cluster.commands import (
    FeatureLevelRaised,
    MarkTime,
    RaiseFeatureLevel,
    TenureBegun,
    TimeMarked,
)
from stampede_rt_supernode.core.command_table import KINDS
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation, Result, Success
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.groups.commands import GroupDeleted, GroupOpened, GroupUpdated
from stampede_rt_supernode.core.hosts.commands import (
    HostDeregistered,
    HostExpired,
    HostLoadsNoted,
    HostRegistered,
    NoteHostLoads,
    ReportedLoad,
)
from stampede_rt_supernode.core.kept_answers import KeptAnswer
from stampede_rt_supernode.core.moves.commands import (
    CommitMove,
    CommitMoves,
    CommitQueueMove,
    MoveCommitted,
    MovesCommitted,
    MovesReleased,
    MoveToCommit,
    MoveToRelease,
    QueueMoveCommitted,
    ReleaseMoves,
)
from stampede_rt_supernode.core.peers.commands import PeerDeregistered, PeerRegistered, PeersExpired
from stampede_rt_supernode.core.queues.commands import QueueDeleted, QueueOpened, QueueUpdated
from stampede_rt_supernode.core.records import (
    ChannelRecord,
    Endpoint,
    GroupRecord,
    GroupSpec,
    HostLoad,
    HostRecord,
    PeerRecord,
    QueueRecord,
    QueueSpec,
    ReplicaKind,
    ReplicaRecord,
)
from stampede_rt_supernode.core.replicas.commands import ReplicaAdded, ReplicaInSyncSet, ReplicaRemoved
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication import COMMAND_BYTES_MAX
from stampede_rt_supernode.servicers.host_loads import HOSTS_PER_ENTRY_MAX
from stampede_rt_supernode.servicers.lease_keeper import PEERS_PER_ENTRY_MAX
from tests.support.supernode.operations import (
    add_replica,
    begin_tenure,
    delete,
    delete_group,
    delete_queue,
    deregister,
    deregister_peer,
    expire,
    expire_peers,
    id_of,
    open_channel,
    open_group,
    open_queue,
    register,
    register_peer,
    remove_replica,
    set_in_sync,
    update,
    update_group,
    update_queue,
)

LOAD = HostLoad(
    busy_permille=2**32 - 1,
    held_bytes=2**64 - 1,
    bytes_max=2**64 - 2,
    owned=2**32 - 2,
    has_archive=True,
    is_private=True,
    machine="m",
)
RULE = AccessRule("cam-*", (AccessVerb.ADVANCE, AccessVerb.PUT), AccessKind.CHANNEL, "video/?", deny=True)
EVERYTHING: dict[str, Any] = {
    "max_age_nanos": 1,
    "max_items": 2,
    "max_bytes": 3,
    "consumers": 4,
    "on_full": "block",
    "max_future_nanos": 0,
    "content_type": "",
    "max_item_bytes": 5,
}
EVERYTHING_OF_QUEUES: dict[str, Any] = {
    "max_items": 1,
    "max_bytes": 2**64 - 1,
    "on_full": "drop_oldest",
    "copies": 2**32 - 1,
    "lease_nanos": 2**63 - 1,
    "max_deliveries": 3,
    "dead_letter_queue_id": id_of(9),
    "content_type": "",
    "max_item_bytes": 4,
    "replicas": 4,
    "ack": "replica",
    "min_replicas": 0,
}
EVERYTHING_OF_PEERS: dict[str, Any] = {
    "mailbox": QueueSpec(**EVERYTHING_OF_QUEUES),
    "mailbox_host_name": "rig",
    "host_id": id_of(3),
    "zone": "lab",
    "version": "0.1.0",
    "attributes": (("", "x"), ("a", ""), ("role", "planner")),
}
OPERATIONS: list[Operation] = [
    open_channel("cam", host="rig", create=False, **EVERYTHING),
    replace(open_channel("cam"), waited_for_index=2**64 - 1),
    *(
        replace(one, created_by="@cluster")
        for one in (open_channel("cam"), open_queue("jobs"), open_group("pair", None))
    ),
    update(id_of(1), 2**64 - 1, max_items=7),
    delete(id_of(1)),
    replace(register(1, boot=2**64 - 1), archive_wait_nanos=2**63 - 1, archive_place="/data/my archive"),
    deregister(1),
    expire(1, registered_index=9, tenure=3),
    begin_tenure(4),
    replace(begin_tenure(5), founded_anew=True),
    open_group("pair", (id_of(1), id_of(2)), reference_channel_id=id_of(2), bound="end", max_lead_nanos=0),
    open_group("pair", (id_of(1),), idle_after_nanos=5),
    open_group("pair", None, create=False),
    update_group(id_of(1), add=(id_of(2), id_of(3)), remove=(id_of(4),), version=0),
    update_group(id_of(1)),
    delete_group(id_of(1)),
    add_replica(id_of(2), 3, epoch=4, warm=True, source=5, acknowledged=True),
    add_replica(id_of(2)),
    remove_replica(id_of(2), 3),
    replace(remove_replica(id_of(2), 3), epoch=4),
    set_in_sync(id_of(2), 3, epoch=4, boot=5),
    replace(set_in_sync(id_of(2), 3, epoch=4, boot=5), change_number=6, added_index=7),
    replace(add_replica(id_of(2), 3, epoch=4, warm=True, acknowledged=True), is_of_queue=True),
    replace(remove_replica(id_of(2), 3), is_of_queue=True),
    replace(set_in_sync(id_of(2), 3, epoch=4, boot=5), is_of_queue=True),
    CommitMove(channel_id=id_of(2), epoch=4, to_host_id=id_of(3), to_boot_incarnation=5, to_registered_index=6),
    CommitQueueMove(queue_id=id_of(2), epoch=4, to_host_id=id_of(3), to_boot_incarnation=5, to_registered_index=6),
    CommitMoves(
        to_host_id=id_of(3),
        to_boot_incarnation=5,
        moves=(
            MoveToCommit(channel_id=id_of(2), epoch=4, permit=b"p"),
            MoveToCommit(channel_id=id_of(4), epoch=2**64 - 1),
        ),
    ),
    ReleaseMoves(host_id=id_of(3), moves=(MoveToRelease(channel_id=id_of(2), epoch=4),)),
    open_queue("jobs", host="rig", create=False, **EVERYTHING_OF_QUEUES),
    open_queue("jobs"),
    update_queue(id_of(2), 2**64 - 1, **EVERYTHING_OF_QUEUES),
    delete_queue(id_of(2)),
    MarkTime(tenure=2**64 - 1, after_index=7),
    NoteHostLoads(tenure=2, loads=(ReportedLoad(host_id=id_of(1), registered_index=2**64 - 1, load=LOAD),)),
    RaiseFeatureLevel(feature_level=2**32 - 1, tenure=2**64 - 1),
    register_peer(1, "planner", boot=2**64 - 1, proof=7, **EVERYTHING_OF_PEERS),
    register_peer(1, "planner", mailbox=QueueSpec()),
    register_peer(1),
    replace(register_peer(1), owner=""),
    replace(register_peer(1), owner="cam"),
    deregister_peer(1, boot=2),
    expire_peers((1, 2), (3, 2**64 - 1), boot=9, tenure=8),
    expire_peers(),
    CreateTokenKey(new_token_key=bytes(32)),
    RevokeCredential(serial="a1b2"),
    AddAccessRule(rule=RULE),
    RemoveAccessRule(rule=AccessRule("@clients", (), None, "*")),
    *(
        replace(one, created_by="cam", created_max=limit)
        for one in (open_channel("cam"), open_queue("q"))
        for limit in (0, 7)
    ),
    SetQuotas(settings=tuple(QuotaSetting("cam-*", quota, LIMIT_MAX) for quota in Quota)),
    RemoveQuotas(who="@10.0.0.*", quotas=tuple(Quota)),
    RemoveQuotas(who="*"),
]
HOST = HostRecord(
    host_id=id_of(1),
    name="rig",
    gatekeepers=(Endpoint(target="a:1"), Endpoint(target="unix:/b", zone="z")),
    boot_incarnation=5,
    version="0.1.0",
    alive=True,
    channels=3,
    registered_index=12,
)
CHANNEL = ChannelRecord(
    channel_id=id_of(2),
    name="cam",
    host_id=id_of(1),
    epoch=3,
    incarnation=2**64 - 1,
    policy=Policy(**EVERYTHING),
    policy_version=2,
    proxy_host_ids=(id_of(8),),
    first_incarnation=2**64 - 2,
)
GROUP = GroupRecord(
    group_id=id_of(4),
    name="pair",
    spec=GroupSpec(channel_ids=(id_of(2), id_of(1)), reference_channel_id=id_of(1), bound="end", idle_after_nanos=1),
    spec_version=2,
    incarnation=2**64 - 1,
)
REPLICA = ReplicaRecord(
    channel_id=id_of(2),
    host_id=id_of(3),
    boot_incarnation=4,
    kind=ReplicaKind.WARM,
    source_host_id=id_of(1),
    in_sync=True,
    acknowledged=True,
    epoch=3,
)
QUEUE = QueueRecord(
    queue_id=id_of(5),
    name="jobs",
    host_id=id_of(1),
    epoch=3,
    incarnation=2**64 - 1,
    spec=QueueSpec(**EVERYTHING_OF_QUEUES),
    spec_version=2,
)
MAILBOX = replace(QUEUE, queue_id=id_of(6), name="", spec=QueueSpec(), mailbox_peer_id=id_of(7))
OWNED_MAILBOX = replace(MAILBOX, mailbox_peer_name="planner", mailbox_owner="cam")
PEER = PeerRecord(
    peer_id=id_of(7),
    name="planner",
    boot_incarnation=8,
    mailbox_queue_id=id_of(6),
    host_id=id_of(1),
    zone="lab",
    version="0.1.0",
    attributes=(("a", ""), ("role", "planner")),
    registered_unix_nano=-1,
    proof_sha256=bytes(32),
    registered_index=9,
    ended_index=10,
)
BARE_PEER = PeerRecord(peer_id=id_of(8), name="", boot_incarnation=8, registered_unix_nano=1, registered_index=9)
OWNED_PEER = replace(BARE_PEER, owner="")
RESULTS: list[Result] = [
    RefusedOperation(reason="NO_HOST", message="none", metadata={"channel": "cam"}),
    ChannelOpened(channel=CHANNEL, host=HOST, created=True),
    ChannelUpdated(channel=CHANNEL),
    ChannelDeleted(channel=CHANNEL),
    ChannelDeleted(channel=CHANNEL, freed_groups=()),
    ChannelDeleted(channel=CHANNEL, freed_groups=("pair", "rig")),
    HostRegistered(host=HOST, cluster_id="c"),
    HostDeregistered(),
    HostExpired(expired=True),
    HostLoadsNoted(noted=2**32 - 1),
    HostRegistered(host=replace(HOST, load=LOAD), cluster_id="c"),
    TenureBegun(tenure=4, cluster_id="c"),
    TimeMarked(marked=True),
    FeatureLevelRaised(feature_level=2),
    GroupOpened(group=GROUP, created=True),
    GroupUpdated(group=GROUP),
    GroupDeleted(),
    GroupDeleted(name="pair"),
    ReplicaAdded(replica=REPLICA, host=HOST),
    ReplicaRemoved(),
    ReplicaInSyncSet(replica=REPLICA),
    MoveCommitted(channel=CHANNEL),
    QueueMoveCommitted(queue=QUEUE),
    MovesCommitted(channels=(CHANNEL,)),
    MovesCommitted(channels=()),
    MovesReleased(channel_ids=(id_of(2), id_of(4))),
    QueueOpened(queue=QUEUE, host=HOST, created=True),
    QueueUpdated(queue=MAILBOX),
    QueueDeleted(queue=QUEUE),
    QueueDeleted(queue=OWNED_MAILBOX),
    PeerRegistered(peer=PEER, mailbox=MAILBOX, mailbox_host=HOST, mailbox_kept=True, cluster_id="c"),
    PeerRegistered(peer=OWNED_PEER, mailbox=None, mailbox_host=None, mailbox_kept=False, cluster_id=""),
    PeerRegistered(peer=BARE_PEER, mailbox=None, mailbox_host=None, mailbox_kept=False, cluster_id="c"),
    PeerDeregistered(),
    PeersExpired(expired=3),
    TokenKeyCreated(version=7),
    CredentialRevoked(revoked=True, version=9),
    AccessRuleAdded(added=True, version=2**64 - 1),
    AccessRuleRemoved(removed=True, version=8),
    QuotasSet(changed=True, version=2**64 - 1),
    QuotasRemoved(removed=1000, version=9),
]


@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda operation: type(operation).__name__)
def test_a_command_is_decoded_as_it_was_encoded(operation: Operation) -> None:
    command = Command(op_id=id_of(3), time_unix_nano=-1, operation=operation, as_of_index=9)
    assert decode_command(encode_command(command)) == command


@pytest.mark.parametrize("result", RESULTS, ids=lambda result: type(result).__name__)
def test_a_result_is_decoded_as_it_was_encoded(result: Result) -> None:
    assert decode_result(encode_result(result)) == result


def test_every_kind_of_command_has_one_row_in_the_table_of_codecs_and_one_in_the_table_of_effects() -> None:
    kinds = directory_command_pb2.DirectoryCommand.DESCRIPTOR.oneofs_by_name["kind"].fields
    outcomes = directory_command_pb2.DirectoryResult.DESCRIPTOR.oneofs_by_name["outcome"].fields
    assert sorted(row.kind for row in CODECS) == sorted(field.name for field in kinds)
    assert sorted(["refused", *(row.outcome for row in CODECS)]) == sorted(field.name for field in outcomes)
    travels = [(row.operation.__name__, row.result.__name__) for row in CODECS]
    does = [(row.operation.__name__, row.result.__name__) for row in KINDS]
    assert sorted(travels) == sorted(does)
    assert len(set(travels)) == len(KINDS)


def test_every_row_of_the_command_table_is_among_the_round_trips() -> None:
    assert {type(operation) for operation in OPERATIONS} == {row.operation for row in KINDS}
    assert {type(result) for result in RESULTS} == {RefusedOperation, *(row.result for row in KINDS)}


def test_a_snapshot_holds_the_kept_answer_to_every_kind_of_command() -> None:
    done = [result for result in RESULTS if isinstance(result, Success)]
    answers = [KeptAnswer(id_of(number), number, "subject", result) for number, result in enumerate(done, 1)]
    assert {type(result) for result in done} == {row.result for row in KINDS}
    assert list(decode_snapshot(encode_snapshot(Directory(index=99, answers=answers))).kept_answers) == answers


def test_the_greatest_command_fits_the_log() -> None:
    widest = "x" * 256
    members = tuple(id_of(number) for number in range(64))
    operations: list[Operation] = [
        replace(register(1), gatekeepers=(Endpoint(target=widest, zone="z" * 64),) * 16, version="v" * 64),
        open_group("x" * 128, members, reference_channel_id=members[0], idle_after_nanos=1, max_lead_nanos=1),
        update_group(id_of(1), add=members, remove=members, version=2**64 - 1),
        register_peer(
            1,
            "x" * 128,
            boot=2**64 - 1,
            proof=255,
            **EVERYTHING_OF_PEERS | {"attributes": tuple((f"{number:032}", "v" * 96) for number in range(32))},
        ),
        expire_peers(*((number, 2**64 - 1) for number in range(PEERS_PER_ENTRY_MAX)), boot=2**64 - 1, tenure=2**64 - 1),
    ]
    loads = (
        ReportedLoad(host_id=id_of(one), registered_index=2**64 - 1, load=LOAD) for one in range(HOSTS_PER_ENTRY_MAX)
    )
    operations.append(NoteHostLoads(tenure=2**64 - 1, loads=tuple(loads)))
    for operation in operations:
        assert len(encode_command(Command(op_id=id_of(1), time_unix_nano=0, operation=operation))) < COMMAND_BYTES_MAX


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        (b"\xff\xff\xff", "INVALID_ARGUMENT"),
        (b"", "VERSION_MISMATCH"),
        (directory_command_pb2.DirectoryCommand(op_id=id_of(1)).SerializeToString(), "VERSION_MISMATCH"),
        (b"\xba\x3e\x02hi", "VERSION_MISMATCH"),  # a field of a newer version
    ],
)
def test_an_unreadable_entry_is_refused_and_later_entries_are_applied(entry: bytes, reason: str) -> None:
    replica = DirectoryReplica()
    result = decode_result(replica.apply(4, entry))
    assert isinstance(result, RefusedOperation)
    assert result.reason == reason
    assert replica.read(lambda directory: directory.applied_index) == 4


def test_an_unknown_value_of_on_full_is_refused() -> None:
    message = directory_command_pb2.DirectoryCommand(op_id=id_of(1))
    message.open_channel.name = "cam"
    message.open_channel.spec.on_full = 9  # type: ignore[assignment]
    result = decode_result(DirectoryReplica().apply(1, message.SerializeToString()))
    assert isinstance(result, RefusedOperation)
    assert "on_full" in result.message


@pytest.mark.parametrize(
    ("field", "value"), [("bound", 9), ("reference", 9), ("reference_channel_id", id_of(1))], ids=str
)
def test_a_group_that_this_version_cannot_read_is_refused(field: str, value: Any) -> None:
    message = directory_command_pb2.DirectoryCommand(op_id=id_of(1))
    message.open_group.name = "pair"
    message.open_group.spec.channel_ids.append(id_of(1))
    setattr(message.open_group.spec, field, value)
    result = decode_result(DirectoryReplica().apply(1, message.SerializeToString()))
    assert isinstance(result, RefusedOperation)
    assert field in result.message


def test_a_snapshot_of_another_format_is_refused() -> None:
    with pytest.raises(VersionMismatch, match="format 4"):
        decode_snapshot(directory_command_pb2.DirectorySnapshot(format_version=4).SerializeToString())


@pytest.mark.parametrize(
    "encoded",
    [
        b"\xff\xff",
        directory_command_pb2.DirectorySnapshot(
            format_version=1, channels=[channel_pb2.ChannelRecord(channel_id=b"c" * 16, host_id=b"nobody" * 2)]
        ).SerializeToString(),
    ],
)
def test_a_snapshot_whose_parts_contradict_each_other_is_refused_and_ends_no_member(encoded: bytes) -> None:
    with pytest.raises(StampedeError, match="the snapshot holds no directory"):
        decode_snapshot(encoded)
