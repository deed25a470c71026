"""Registers, deregisters and expires hosts in the tables, and checks who may do so. Pure.

A lease belongs to one registration. Its end is a log entry that names the boot incarnation, the registration and the
leader's tenure. If any of these has changed since, the entry has no effect.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import HostExists, InvalidArgument, LeaseExpired, Overloaded
from stampede_rt_runtime.access.move_permits import KEY_BYTES
from stampede_rt_supernode.core.channels.transitions import fresh_incarnation
from stampede_rt_supernode.core.groups.transitions import note_lost_cuts
from stampede_rt_supernode.core.hosts.commands import DeregisterHost, ExpireHost, NoteHostLoads, RegisterHost
from stampede_rt_supernode.core.queues.placement import move_waiting_mailboxes, reset_queues
from stampede_rt_supernode.core.records import HostLoad, HostRecord
from stampede_rt_supernode.core.registration_epochs import check_registration_epoch, next_epoch
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.takeover import end_registration, give_owner
from stampede_rt_supernode.core.validation import (
    MACHINE_CHARACTERS_MAX,
    PLACE_CHARACTERS_MAX,
    check_gatekeepers,
    check_id,
    check_incarnation,
    check_name,
    check_text,
    check_version,
)

HOSTS_MAX = 10_000


def register_host(tables: Tables, operation: RegisterHost, *, has_level_4: bool = False) -> HostRecord:
    """Register a host, perhaps again.

    A new boot incarnation means that the host lost its items. Then, in this one step, all its channels and queues get a
    new epoch and incarnation. A channel with a warm replica in sync moves to the host of that replica. The other
    channels and all queues stay at the host. Recorded channels keep their incarnation if the host's archive has all of
    their items. `has_level_4`: the feature level allows loads, archives and keys of moves; until its
    first report the host counts as idle.
    """
    check_register(operation)
    _check_name_is_free(tables, operation)
    before = tables.hosts.get(operation.host_id)
    if before is None and len(tables.hosts) >= HOSTS_MAX:
        text = f"host {operation.name} cannot register: the directory holds {HOSTS_MAX} hosts, the limit"
        raise Overloaded(text, metadata={"host": operation.name})
    epoch = next_epoch(operation, [before])
    tables.put_host(
        HostRecord(
            host_id=operation.host_id,
            name=operation.name,
            gatekeepers=operation.gatekeepers,
            boot_incarnation=operation.boot_incarnation,
            version=operation.version,
            alive=True,
            channels=before.channels if before is not None else 0,
            registered_index=tables.index,
            registration_epoch=epoch,
            load=_idle_load(tables, before, operation) if has_level_4 else None,
            move_key=operation.move_key if has_level_4 else b"",
            archive_wait_nanos=operation.archive_wait_nanos if has_level_4 else 0,
            archive_place=operation.archive_place if has_level_4 else "",
        )
    )
    tables.forget_lost_hosts(operation.name)
    if before is not None and before.boot_incarnation != operation.boot_incarnation:
        end_registration(tables, operation.host_id)
        continues = has_level_4 and before.boot_incarnation == operation.continues_boot_incarnation
        _reset_channels(tables, operation, continues=continues)
        reset_queues(tables, tables.hosts[operation.host_id], operation.new_incarnation)
    if len(tables.host_ids) == 1:
        move_waiting_mailboxes(tables)
    return tables.hosts[operation.host_id]


def _idle_load(tables: Tables, before: HostRecord | None, operation: RegisterHost) -> HostLoad:
    """The load of a host until its first report: idle, with all things that it owns already."""
    owned = 0 if before is None else before.channels + tables.queues.count_at(before.host_id)
    return HostLoad(
        owned=owned,
        has_archive=operation.has_archive,
        is_private=operation.is_private,
        machine=operation.machine,
    )


def check_register(operation: RegisterHost) -> None:
    """Check the operation without the tables. Raises InvalidName or InvalidArgument."""
    check_id(operation.host_id, "host_id")
    check_name(operation.name, "host")
    check_gatekeepers(operation.gatekeepers, operation.name)
    check_version(operation.version, operation.name)
    check_text(operation.machine, f"the machine of host {operation.name}", 0, MACHINE_CHARACTERS_MAX)
    place = f"the place of the archive of host {operation.name}"
    check_text(operation.archive_place, place, 0, PLACE_CHARACTERS_MAX, may_have_blanks=True)
    check_incarnation(operation.boot_incarnation, "boot_incarnation")
    check_incarnation(operation.new_incarnation, "new_incarnation")
    check_registration_epoch(operation)
    if operation.move_key and len(operation.move_key) != KEY_BYTES:
        text = f"host {operation.name}: move_key has {len(operation.move_key)} bytes; give {KEY_BYTES} random ones"
        raise InvalidArgument(text, metadata={"host": operation.name, "field": "move_key"})


def _check_name_is_free(tables: Tables, operation: RegisterHost) -> None:
    holder = tables.live_host_named(operation.name)
    if holder is not None and holder.host_id != operation.host_id:
        raise HostExists(
            f"another live host has the name {operation.name}; take another name, or wait until that host leaves or "
            "its lease ends",
            metadata={"host": operation.name, "host_id": holder.host_id.hex()},
        )


def _reset_channels(tables: Tables, operation: RegisterHost, *, continues: bool) -> None:
    left = tables.channels_at(operation.host_id)
    for channel in left:
        is_whole = continues and channel.policy.is_recorded
        incarnation = channel.incarnation if is_whole else fresh_incarnation(channel, operation.new_incarnation)
        give_owner(tables, channel, channel.after_restart(incarnation))
    note_lost_cuts(tables, (channel.channel_id for channel in left), restarted=operation.host_id)


def deregister_host(tables: Tables, operation: DeregisterHost) -> None:
    """Deregister a host. A channel or queue with a warm replica in sync gets that replica's host as its owner.

    The host's other mailboxes move to other hosts. Its other channels and queues have no live owner from then on. If
    the host is lost, the call only takes it off the list of lost hosts. Does nothing if the host is not registered.
    Raises LeaseExpired for another boot incarnation.
    """
    check_id(operation.host_id, "host_id")
    host = tables.hosts.get(operation.host_id)
    if host is None or not (host.alive or host.is_lost):
        return
    check_boot(host, operation.boot_incarnation)
    if host.alive:
        _end(tables, host)
    else:
        tables.put_host(replace(host, lease_ended_unix_nano=None))


def check_boot(host: HostRecord, boot_incarnation: int) -> None:
    """Raises LeaseExpired if another process of the host has registered, with another boot incarnation."""
    if host.boot_incarnation != boot_incarnation:
        raise LeaseExpired(
            f"the lease of host {host.name} belongs to another process, started with another boot incarnation; "
            "register again, and make sure that two processes do not share one data folder",
            metadata={"host": host.name},
        )


def expire_host(tables: Tables, operation: ExpireHost, tenure: int, now_unix_nano: int) -> bool:
    """End a lease, unless the command comes too late. Returns whether the lease ended. `tenure`: the present tenure.

    The directory lists the host as lost until it registers again or deregisters, until another live host takes its
    name, or until LOST_HOSTS_MAX other hosts were lost after it.
    """
    host = tables.hosts.get(operation.host_id)
    if host is None or not host.alive or operation.tenure != tenure:
        return False
    if (host.boot_incarnation, host.registered_index) != (operation.boot_incarnation, operation.registered_index):
        return False
    _end(tables, host, lost_unix_nano=now_unix_nano)
    return True


def note_host_loads(tables: Tables, operation: NoteHostLoads, tenure: int) -> int:
    """Set the loads of hosts. Ignores the loads that a former leader noted, and the loads of former registrations.

    Returns the number of loads set.
    """
    noted = 0
    for one in operation.loads if operation.tenure == tenure else ():
        host = tables.hosts.get(one.host_id)
        if host is not None and host.alive and host.registered_index == one.registered_index:
            tables.set_load(host.host_id, one.load)
            noted += 1
    return noted


def _end(tables: Tables, host: HostRecord, lost_unix_nano: int | None = None) -> None:
    tables.put_host(replace(host, alive=False, lease_ended_unix_nano=lost_unix_nano))
    end_registration(tables, host.host_id)
