"""After any commands, the directory's invariants hold, and all replicas agree."""

from __future__ import annotations

import os

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, rule

from stampede_rt.values.model import Policy
from stampede_rt_supernode.core.channels.commands import DeleteChannel, OpenChannel, UpdateChannel
from stampede_rt_supernode.core.cluster.commands import BeginTenure
from stampede_rt_supernode.core.hosts.commands import DeregisterHost, ExpireHost, RegisterHost
from stampede_rt_supernode.core.records import (
    ChangeKind,
    ChannelRecord,
    Endpoint,
    GroupRecord,
    GroupSpec,
    ReplicaKind,
    ReplicaRecord,
)
from stampede_rt_supernode.core.replicas.commands import ReplicaAdded, SetReplicaInSync
from tests.support.supernode.drawn_records import group_changes, moves, open_groups, replica_operations
from tests.support.supernode.operations import add_replica, id_of, open_channel, open_group, register
from tests.support.supernode.three_directories import ThreeDirectories

hosts = st.integers(1, 4).map(id_of)
host_names = st.sampled_from(["", "a", "b", "c", "Bad"])
channel_names = st.sampled_from(["x", "y", "z", "x/y", "-"])
boots = st.integers(0, 2)
incarnations = st.sampled_from([1, 2, 3, 2**64 - 1, 0])
small = st.none() | st.integers(0, 3)
policies = st.builds(
    Policy, max_age_nanos=small, max_items=small, consumers=small, on_full=st.sampled_from([None, "block", "reject"])
)


def is_former_owner(copy: ReplicaRecord) -> bool:
    return copy.kind is ReplicaKind.MOVE


class DirectoryMachine(ThreeDirectories):
    """Hosts, channels, groups and copies."""

    @initialize(populated=st.sampled_from([True, True, True, False]))
    def found(self, populated: bool) -> None:
        self.epochs: dict[bytes, tuple[int, int]] = {}
        self.mirror: dict[bytes, ChannelRecord] = {}
        self.groups_mirror: dict[bytes, GroupRecord] = {}
        self.versions: dict[bytes, tuple[int, GroupSpec]] = {}
        self.position = 0
        if populated:
            self.populate()

    def populate(self) -> None:
        """Add hosts, channels, groups and copies, because random commands seldom make all of them."""
        self.apply(BeginTenure(tenure=1, supernode_id="s", new_cluster_id="c", new_lease_ttl_nanos=1), self.fresh_id())
        for number, name in enumerate(("a", "b", "c"), start=1):
            self.apply(register(number, name=name), self.fresh_id())
        for name in ("x", "y", "z"):
            self.apply(open_channel(name), self.fresh_id())
        channel_ids = tuple(self.directory.tables.channels)
        self.apply(open_group("g", channel_ids[:2]), self.fresh_id())
        for copy in (add_replica(channel_ids[0], warm=True), add_replica(channel_ids[1], warm=True)):
            added = self.apply(copy, self.fresh_id())
            assert isinstance(added, ReplicaAdded)
            report = SetReplicaInSync(
                channel_id=copy.channel_id, epoch=1, host_id=added.host.host_id, boot_incarnation=1, in_sync=True
            )
            self.apply(report, self.fresh_id())

    op_ids = st.none() | st.integers(1, 6).map(id_of)

    @rule(name=channel_names, policy=policies, create=st.booleans(), host=host_names, new=incarnations, op_id=op_ids)
    def open(self, name: str, policy: Policy, create: bool, host: str, new: int, op_id: bytes | None) -> None:
        operation = OpenChannel(
            name=name, policy=policy, create=create, host_name=host, new_channel_id=self.fresh_id(), new_incarnation=new
        )
        self.apply(operation, op_id or self.fresh_id())

    @rule(which=st.integers(0, 5), epoch_off=st.sampled_from([0, 0, 1]), policy=policies)
    def update(self, which: int, epoch_off: int, policy: Policy) -> None:
        channel = self.some_channel(which)
        epoch = (channel.epoch if channel else 1) + epoch_off
        channel_id = channel.channel_id if channel else self.fresh_id()
        self.apply(UpdateChannel(channel_id=channel_id, epoch=epoch, policy=policy), self.fresh_id())

    @rule(which=st.integers(0, 5), op_id=op_ids)
    def delete(self, which: int, op_id: bytes | None) -> None:
        channel = self.some_channel(which)
        channel_id = channel.channel_id if channel else self.fresh_id()
        self.apply(DeleteChannel(channel_id=channel_id), op_id or self.fresh_id())

    @rule(host=hosts, name=host_names, boot=boots, new=incarnations, op_id=op_ids, skip=st.integers(1, 3))
    def register(self, host: bytes, name: str, boot: int, new: int, op_id: bytes | None, skip: int) -> None:
        operation = RegisterHost(
            host_id=host,
            name=name,
            gatekeepers=(Endpoint(target="h:1"),),
            boot_incarnation=boot,
            new_incarnation=new,
        )
        self.apply(operation, op_id or self.fresh_id(), skip)

    @rule(host=hosts, boot=boots)
    def deregister(self, host: bytes, boot: int) -> None:
        self.apply(DeregisterHost(host_id=host, boot_incarnation=boot), self.fresh_id())

    @rule(host=hosts, late=st.booleans(), tenure_off=st.sampled_from([0, 0, 1]))
    def expire(self, host: bytes, late: bool, tenure_off: int) -> None:
        held = self.directory.tables.hosts.get(host)
        operation = ExpireHost(
            host_id=host,
            boot_incarnation=held.boot_incarnation if held else 1,
            registered_index=(held.registered_index if held else 1) - late,
            tenure=self.directory.tenure + tenure_off,
        )
        self.apply(operation, self.fresh_id())

    @rule(tenure=st.integers(1, 5))
    def begin_tenure(self, tenure: int) -> None:
        before = self.directory.tenure
        operation = BeginTenure(
            tenure=tenure, supernode_id="s", new_cluster_id=f"c{tenure}", new_lease_ttl_nanos=tenure
        )
        self.apply(operation, self.fresh_id())
        assert self.directory.tenure == max(before, tenure)

    @rule(data=st.data(), op_id=op_ids)
    def open_group(self, data: st.DataObject, op_id: bytes | None) -> None:
        self.apply(data.draw(open_groups(self.directory, self.fresh_id())), op_id or self.fresh_id())

    @rule(data=st.data())
    def change_group(self, data: st.DataObject) -> None:
        self.apply(data.draw(group_changes(self.directory)), self.fresh_id())

    @rule(data=st.data(), op_id=op_ids)
    def change_replica(self, data: st.DataObject, op_id: bytes | None) -> None:
        self.apply(data.draw(replica_operations(self.directory)), op_id or self.fresh_id())

    @rule(data=st.data(), op_id=op_ids)
    def move(self, data: st.DataObject, op_id: bytes | None) -> None:
        self.apply(data.draw(moves(self.directory)), op_id or self.fresh_id())

    def some_channel(self, which: int) -> ChannelRecord | None:
        channels = [self.directory.tables.channels[one] for one in sorted(self.directory.tables.channels)]
        return channels[which % len(channels)] if channels else None

    @invariant()
    def names_and_ids_are_one_to_one(self) -> None:
        tables = self.directory.tables
        assert dict(tables.channel_ids) == {channel.name: one for one, channel in tables.channels.items()}
        live = {host.name: one for one, host in tables.hosts.items() if host.alive}
        assert dict(tables.host_ids) == live
        assert len(live) == sum(host.alive for host in tables.hosts.values())

    @invariant()
    def every_channel_has_a_known_owner_and_the_counts_agree(self) -> None:
        tables = self.directory.tables
        for one, host in tables.hosts.items():
            owned = sorted(channel.channel_id for channel in tables.channels.values() if channel.host_id == one)
            assert [channel.channel_id for channel in tables.channels_at(one)] == owned
            assert host.channels == len(owned)
            assert host.alive or owned or host.is_lost, "a host that has left and owns nothing has no record"
        assert {channel.host_id for channel in tables.channels.values()} <= set(tables.hosts)

    @invariant()
    def group_names_and_ids_are_one_to_one_and_the_members_of_groups_exist(self) -> None:
        tables = self.directory.tables
        groups = tables.groups
        assert dict(groups.ids) == {group.name: one for one, group in groups.by_id.items()}
        for group in groups.by_id.values():
            members = group.spec.channel_ids
            assert members
            assert set(members) <= set(tables.channels)
            assert group.spec.reference_channel_id in (None, *members)
            witnesses = groups.witnesses_of(group)
            assert witnesses
            former = {copy.host_id for one in members for copy in tables.replicas.of(one) if is_former_owner(copy)}
            assert set(witnesses) <= {tables.channels[one].host_id for one in members} | former
        for one in tables.channels:
            with_it = [group for group in groups.by_id.values() if one in group.spec.channel_ids]
            assert sorted(group.group_id for group in with_it) == [g.group_id for g in groups.with_channel(one)]

    @invariant()
    def copies_are_at_live_hosts_with_the_same_boot_number_and_the_channel_names_these_hosts(self) -> None:
        tables = self.directory.tables
        held: dict[bytes, set[bytes]] = {}
        for channel in tables.channels.values():
            copies = tables.replicas.of(channel.channel_id)
            assert channel.proxy_host_ids == tuple(copy.host_id for copy in copies if not is_former_owner(copy))
            places = {channel.host_id, *(copy.host_id for copy in copies)}
            assert len(places) == len(copies) + 1, "a host has at most one copy, and the owner has none"
            for copy in copies:
                host = tables.hosts[copy.host_id]
                assert (host.alive, host.boot_incarnation) == (True, copy.boot_incarnation)
                assert copy.source_host_id in places - {copy.host_id}
                assert copy.epoch <= channel.epoch
                assert not copy.in_sync or (copy.kind is not ReplicaKind.PROXY and tables.hosts[channel.host_id].alive)
                assert not copy.in_sync or copy.epoch == channel.epoch
                held.setdefault(copy.host_id, set()).add(channel.channel_id)
        for host_id in tables.hosts:
            assert tables.replicas.channel_ids_at(host_id) == sorted(held.get(host_id, ()))

    @invariant()
    def an_epoch_never_falls_and_an_incarnation_changes_only_with_it(self) -> None:
        now = {one: (c.epoch, c.incarnation) for one, c in self.directory.tables.channels.items()}
        for one, (epoch, incarnation) in now.items():
            held_epoch, held_incarnation = self.epochs.get(one, (epoch, incarnation))
            assert epoch >= held_epoch
            assert incarnation == held_incarnation or epoch > held_epoch
            assert incarnation != 0
        self.epochs |= now

    @invariant()
    def a_group_changes_its_members_only_with_its_version(self) -> None:
        now = {one: (g.spec_version, g.spec) for one, g in self.directory.tables.groups.by_id.items()}
        for one, (version, spec) in now.items():
            held_version, held_spec = self.versions.get(one, (version, spec))
            assert version >= held_version
            assert (version == held_version) == (spec == held_spec) or version > held_version + 1
        self.versions |= now

    @invariant()
    def a_watcher_that_applies_the_changes_has_the_present_channels_and_groups(self) -> None:
        page = self.directory.tables.changes.read(self.position, 10_000)
        assert page is not None
        self.position = page.position
        for change in page.changes:
            if isinstance(change.subject, GroupRecord):
                if change.kind is ChangeKind.REMOVED:
                    del self.groups_mirror[change.subject.group_id]
                else:
                    self.groups_mirror[change.subject.group_id] = change.subject
            elif isinstance(change.subject, ChannelRecord):
                if change.kind is ChangeKind.REMOVED:
                    del self.mirror[change.subject.channel_id]
                else:
                    self.mirror[change.subject.channel_id] = change.subject
        assert self.mirror == self.directory.tables.channels
        assert self.groups_mirror == self.directory.tables.groups.by_id


TestDirectory = DirectoryMachine.TestCase
TestDirectory.settings = settings(
    max_examples=int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "40")), stateful_step_count=40
)
