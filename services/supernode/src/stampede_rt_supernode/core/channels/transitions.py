"""Opens, changes and deletes channels in the tables (paper, sections 4.2 and 4.3). Pure.

Each function checks everything first, and edits after that. It either raises a StampedeError without any change, or
succeeds.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import ChannelNotFound, InvalidArgument, Overloaded, StampedeError, Unavailable
from stampede_rt_supernode.core.channels.commands import (
    ChannelDeleted,
    ChannelOpened,
    ChannelUpdated,
    DeleteChannel,
    OpenChannel,
    UpdateChannel,
)
from stampede_rt_supernode.core.channels.policies import agree, check_fixed, check_policy, check_ranges, merge
from stampede_rt_supernode.core.channels.waiting import check_waited
from stampede_rt_supernode.core.groups.transitions import note_lost_cuts
from stampede_rt_supernode.core.hosts.placement import (
    beside_its_group,
    check_has_place,
    has_room_by_report,
    least_loaded,
)
from stampede_rt_supernode.core.lookups import channel_by_id, check_host_agrees, host_by_name, no_such_channel
from stampede_rt_supernode.core.records import ChannelRecord, HostRecord
from stampede_rt_supernode.core.replicas.transitions import check_epoch, end_replicas
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.takeover import forget_channel, give_owner
from stampede_rt_supernode.core.validation import check_id, check_incarnation, check_name

CHANNELS_MAX = 200_000


def check_open(operation: OpenChannel) -> None:
    """Check the operation without the tables. Raises InvalidName or InvalidArgument."""
    check_name(operation.name, "channel")
    if operation.host_name:
        check_name(operation.host_name, "host")
    if operation.beside:
        _check_beside(operation)
    check_ranges(operation.name, operation.policy)
    check_id(operation.new_channel_id, "new_channel_id")
    check_incarnation(operation.new_incarnation, "new_incarnation")


def _check_beside(operation: OpenChannel) -> None:
    check_name(operation.beside, "channel")
    if operation.host_name:
        raise InvalidArgument(
            f"channel {operation.name} has a host, {operation.host_name}, and a channel to be beside, "
            f"{operation.beside}; state one of them",
            metadata={"channel": operation.name, "field": "beside"},
        )


def check_update(operation: UpdateChannel) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.channel_id, "channel_id")
    check_ranges(operation.channel_id.hex(), operation.policy)


def open_channel(tables: Tables, operation: OpenChannel) -> ChannelOpened:
    """Get or create a channel.

    A channel whose owner's lease has ended gets a new owner, epoch and incarnation. Its items are lost. A recorded
    channel first waits for its owner, see `waiting`.
    """
    check_open(operation)
    channel = tables.channel_named(operation.name)
    if channel is None:
        return _create(tables, operation)
    check_host_agrees("channel", channel.name, tables.hosts[channel.host_id], operation.host_name)
    policy = agree(channel.name, channel.policy, operation.policy)
    opened = replace(channel, policy=policy, policy_version=channel.policy_version + (policy != channel.policy))
    if not tables.hosts[channel.host_id].alive:
        check_waited(tables, operation)
        give_owner(tables, channel, _with_new_owner(tables, opened, operation))
        note_lost_cuts(tables, [channel.channel_id])
    elif opened != channel:
        tables.replace_channel(opened)
    opened = tables.channels[channel.channel_id]
    return ChannelOpened(channel=opened, host=tables.hosts[opened.host_id], created=False)


def open_unchanged(tables: Tables, operation: OpenChannel) -> ChannelOpened | None:
    """The answer to `operation` if it changes nothing; otherwise None.

    Raises the errors of `open_channel`, except the errors for a missing host or for a full directory or host.
    """
    check_open(operation)
    channel = tables.channel_named(operation.name)
    if channel is None:
        if not operation.create:
            raise no_such_channel(operation.name)
        check_policy(operation.name, operation.policy)
        return None
    host = tables.hosts[channel.host_id]
    check_host_agrees("channel", channel.name, host, operation.host_name)
    unchanged = agree(channel.name, channel.policy, operation.policy) == channel.policy
    return ChannelOpened(channel=channel, host=host, created=False) if unchanged and host.alive else None


def update_channel(tables: Tables, operation: UpdateChannel) -> ChannelUpdated:
    """Change the stated fields of a channel's policy. The other fields stay."""
    check_update(operation)
    channel = channel_by_id(tables, operation.channel_id)
    check_epoch(channel, operation.epoch)
    check_fixed(channel.name, channel.policy, operation.policy)
    policy = merge(channel.policy, operation.policy)
    check_policy(channel.name, policy)
    if policy != channel.policy:
        changed = replace(channel, policy=policy, policy_version=channel.policy_version + 1)
        tables.replace_channel(changed)
        ends = channel.policy.replicas and not policy.replicas
        if ends or (policy.ack == "replica") != (channel.policy.ack == "replica"):
            end_replicas(tables, changed)
        channel = tables.channels[channel.channel_id]
    return ChannelUpdated(channel=channel)


def delete_channel(tables: Tables, operation: DeleteChannel) -> ChannelDeleted:
    """Delete a channel, and free its name."""
    channel = channel_by_id(tables, operation.channel_id)
    return ChannelDeleted(channel=channel, freed_groups=forget_channel(tables, channel))


def _create(tables: Tables, operation: OpenChannel) -> ChannelOpened:
    if not operation.create:
        raise no_such_channel(operation.name)
    check_policy(operation.name, operation.policy)
    tables.channel_creators.check(operation, "channels")
    if len(tables.channels) >= CHANNELS_MAX:
        raise Overloaded(
            f"channel {operation.name} cannot be created: the directory holds {CHANNELS_MAX} channels, the limit; "
            "delete some",
            metadata={"channel": operation.name},
        )
    host = _choose_host(tables, operation, recorded=operation.policy.is_recorded)
    check_has_place(host, operation.name)
    channel = ChannelRecord(
        channel_id=operation.new_channel_id,
        name=operation.name,
        host_id=host.host_id,
        epoch=1,
        incarnation=operation.new_incarnation,
        policy=operation.policy,
        policy_version=1,
        created_by=operation.created_by,
        first_incarnation=operation.new_incarnation if operation.policy.is_recorded else 0,
    )
    tables.add_channel(channel)
    return ChannelOpened(channel=channel, host=tables.hosts[host.host_id], created=True)


def _with_new_owner(tables: Tables, channel: ChannelRecord, operation: OpenChannel) -> ChannelRecord:
    former = tables.hosts[channel.host_id].name
    recorded = channel.policy.is_recorded
    host = _choose_host(tables, operation, former=former, channel_id=channel.channel_id, recorded=recorded)
    check_has_place(host, channel.name)
    return replace(
        channel,
        host_id=host.host_id,
        epoch=channel.epoch + 1,
        incarnation=fresh_incarnation(channel, operation.new_incarnation),
    )


def fresh_incarnation(channel: ChannelRecord, proposed: int) -> int:
    """`proposed`, or another number if the channel has that incarnation already (one case in 2**64)."""
    return proposed if proposed != channel.incarnation else (proposed ^ 1) or 2


def _choose_host(
    tables: Tables,
    operation: OpenChannel,
    former: str | None = None,
    channel_id: bytes = b"",
    *,
    recorded: bool,
) -> HostRecord:
    """The host for a new channel, or for the channel `channel_id`, whose owner is not alive.

    The first of these hosts that exists: the live host that the caller names; the live host with the name of the
    `former` owner, which has restarted without its data folder; the host of the channel `operation.beside`, if this
    host is alive and has room; the host of the other members of the channel's groups, if it has room; the least loaded
    live host (see `placement`). A channel that is `recorded` gets only a host with an archive.
    """
    if operation.host_name:
        return _named_host(tables, operation, recorded=recorded)
    successor = tables.live_host_named(former) if former is not None else None
    near = (successor, _host_beside(tables, operation, channel_id), beside_its_group(tables, channel_id))
    for host in near:
        if host is not None and (not recorded or can_record(host)):
            return host
    hosts = (host for host in tables.live_hosts() if not recorded or can_record(host))
    least = least_loaded(tables, hosts, lambda host: host.channels)
    if least is None:
        has_hosts = next(iter(tables.live_hosts()), None) is not None
        raise _no_host(operation.name, is_new=not channel_id and has_hosts, recorded=recorded)
    return least


def can_record(host: HostRecord) -> bool:
    """Whether the host has an archive, as far as the directory knows."""
    return host.load is not None and host.load.has_archive


def _named_host(tables: Tables, operation: OpenChannel, *, recorded: bool) -> HostRecord:
    host = host_by_name(tables, operation.host_name)
    if recorded and not can_record(host):
        raise InvalidArgument(
            f"channel {operation.name} is to be recorded, and host {host.name} has no archive; leave `host` out, or "
            "start that host with --archive FOLDER",
            metadata={"channel": operation.name, "host": host.name, "field": "host"},
        )
    return host


def _no_host(channel: str, *, is_new: bool, recorded: bool) -> StampedeError:
    """The error for a channel that gets no host. An existing recorded channel may wait until its host is back."""
    metadata = {"channel": channel}
    if not recorded:
        text = f"there is no live host for channel {channel}; start one with `stampede host`, or wait for one"
        return Unavailable(text, reason="NO_HOST", metadata=metadata)
    how = "start one with `stampede host --archive FOLDER` or `st.host(archive=...)`"
    text = f"channel {channel} is to be recorded (archive), and no live host has an archive; {how}"
    if is_new:
        return InvalidArgument(text, metadata=metadata)
    return Unavailable(f"{text}, or wait for one", reason="NO_HOST", metadata=metadata)


def _host_beside(tables: Tables, operation: OpenChannel, channel_id: bytes) -> HostRecord | None:
    """The live host of the channel `operation.beside`, if it has room; otherwise None.

    Raises ChannelNotFound if a new channel names a channel that does not exist. An existing channel then gets another
    host, because a program that opens it may be unable to create the missing channel.
    """
    if not operation.beside:
        return None
    other = tables.channel_named(operation.beside)
    if other is None and not channel_id:
        raise ChannelNotFound(
            f"channel {operation.name} cannot be created beside channel {operation.beside}, because there is no such "
            "channel; open that one first, or leave `beside` out",
            metadata={"channel": operation.beside},
        )
    host = tables.hosts[other.host_id] if other is not None else None
    return host if host is not None and host.alive and has_room_by_report(tables, host) else None
