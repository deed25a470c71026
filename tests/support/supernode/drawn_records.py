"""Draws operations on groups and copies for the property tests. Few ids are drawn, so many operations share one."""

from __future__ import annotations

from hypothesis import strategies as st

from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.groups.commands import DeleteGroup, OpenGroup, UpdateGroup
from stampede_rt_supernode.core.moves.commands import CommitMove
from stampede_rt_supernode.core.records import ChannelRecord, GroupRecord, GroupSpec, ReplicaKind
from stampede_rt_supernode.core.replicas.commands import AddReplica, RemoveReplica, SetReplicaInSync
from tests.support.supernode.operations import id_of

host_ids = st.integers(1, 4).map(id_of)
numbers = st.integers(0, 5)


def some(directory: Directory, number: int) -> ChannelRecord | None:
    channels = directory.tables.channels
    return channels[sorted(channels)[number % len(channels)]] if channels else None


def some_group(directory: Directory, number: int) -> GroupRecord | None:
    groups = directory.tables.groups.by_id
    return groups[sorted(groups)[number % len(groups)]] if groups else None


def ids_of(directory: Directory, chosen: list[int]) -> tuple[bytes, ...]:
    """Return the ids of the channels that the numbers choose, each once. Number 5 stands for an unknown id."""
    found = (some(directory, number) if number < 5 else None for number in chosen)
    return tuple(dict.fromkeys(channel.channel_id if channel else id_of(9999) for channel in found))


@st.composite
def open_groups(draw: st.DrawFn, directory: Directory, new_group_id: bytes) -> OpenGroup:
    members = ids_of(directory, draw(st.lists(st.integers(0, 5), max_size=4)))
    spec = GroupSpec(
        channel_ids=members,
        reference_channel_id=draw(st.sampled_from([None, None, *members, id_of(9998)])),
        bound=draw(st.sampled_from(["start", "start", "end"])),
        idle_after_nanos=draw(st.sampled_from([None, None, 0, 1])),
        max_lead_nanos=draw(st.sampled_from([None, None, 5 * 10**9, -1])),
    )
    return OpenGroup(
        name=draw(st.sampled_from(["g", "h", "x", "-"])),
        spec=draw(st.sampled_from([spec, spec, spec, None])),
        create=draw(st.sampled_from([True, True, False])),
        new_group_id=new_group_id,
        new_incarnation=draw(st.sampled_from([1, 2, 2**64 - 1, 0])),
    )


@st.composite
def group_changes(draw: st.DrawFn, directory: Directory) -> UpdateGroup | DeleteGroup:
    group = some_group(directory, draw(numbers))
    group_id = group.group_id if group else id_of(9997)
    if draw(st.integers(0, 5)) == 0:
        return DeleteGroup(group_id=group_id)
    version = group.spec_version if group else 1
    return UpdateGroup(
        group_id=group_id,
        add_channel_ids=ids_of(directory, draw(st.lists(numbers, max_size=2))),
        remove_channel_ids=ids_of(directory, draw(st.lists(numbers, max_size=2))),
        spec_version=draw(st.sampled_from([None, version, version + 1])),
    )


@st.composite
def replica_operations(draw: st.DrawFn, directory: Directory) -> AddReplica | RemoveReplica | SetReplicaInSync:
    channel = some(directory, draw(numbers))
    channel_id, epoch = (channel.channel_id, channel.epoch) if channel else (id_of(9996), 1)
    epoch += draw(st.sampled_from([0, 0, 0, 1]))
    held = directory.tables.replicas.of(channel_id)
    host_id = draw(host_ids)
    what = draw(st.integers(0, 5))
    if what == 0:
        return RemoveReplica(channel_id=channel_id, host_id=host_id)
    if what <= 2 and held:
        copy = held[draw(numbers) % len(held)]
        boot = copy.boot_incarnation + draw(st.sampled_from([0, 0, 0, 1]))
        return SetReplicaInSync(
            channel_id=channel_id,
            epoch=epoch,
            host_id=copy.host_id,
            boot_incarnation=boot,
            in_sync=draw(st.sampled_from([True, True, False])),
        )
    return AddReplica(
        channel_id=channel_id,
        epoch=epoch,
        host_id=draw(st.sampled_from([host_id, host_id, b""])),
        kind=draw(st.sampled_from((ReplicaKind.PROXY, ReplicaKind.WARM))),
        source_host_id=draw(st.sampled_from([b"", b"", host_id, *(one.host_id for one in held)])),
        acknowledged=draw(st.booleans()),
    )


@st.composite
def moves(draw: st.DrawFn, directory: Directory) -> CommitMove:
    """A move, mostly of an existing channel at its present epoch, to a host with its present incarnation."""
    channel, host_id = some(directory, draw(numbers)), draw(host_ids)
    host = directory.tables.hosts.get(host_id)
    return CommitMove(
        channel_id=channel.channel_id if channel else id_of(9999),
        epoch=(channel.epoch if channel else 1) - draw(st.sampled_from([0, 0, 0, 1])),
        to_host_id=host_id,
        to_boot_incarnation=draw(st.sampled_from([host.boot_incarnation if host else 1, 7])),
    )
