"""Whatever the log brings, the directory's invariants hold, and every replica says the same."""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from stampede_rt.model import Policy
from stampede_rt_supernode.command_codec import decode_command, encode_command, encode_result
from stampede_rt_supernode.commands import (
    BeginTenure,
    Command,
    Deed,
    DeleteChannel,
    DeregisterHost,
    ExpireHost,
    OpenChannel,
    Refused,
    RegisterHost,
    Result,
    UpdateChannel,
)
from stampede_rt_supernode.directory import Directory
from stampede_rt_supernode.records import ChangeKind, Channel, Endpoint
from stampede_rt_supernode.snapshot_codec import SnapshotWriter, decode_snapshot, encode_snapshot
from tests.unit.supernode.deeds import id_of

hosts = st.integers(1, 4).map(id_of)
host_names = st.sampled_from(["", "a", "b", "c", "Bad"])
channel_names = st.sampled_from(["x", "y", "z", "x/y", "-"])
boots = st.integers(0, 2)
incarnations = st.integers(0, 3)
small = st.none() | st.integers(0, 3)
policies = st.builds(
    Policy, max_age_nanos=small, max_items=small, consumers=small, on_full=st.sampled_from([None, "block", "reject"])
)


class DirectoryMachine(RuleBasedStateMachine):
    """`directory` is fed values, `twin` encoded bytes, `restored` is replaced by its own snapshot now and then."""

    @initialize()
    def found(self) -> None:
        self.directory, self.twin, self.restored = Directory(), Directory(), Directory()
        self.index = 0
        self.drawn = 0
        self.epochs: dict[bytes, tuple[int, int]] = {}
        self.writer = SnapshotWriter()
        self.mirror: dict[bytes, Channel] = {}
        self.position = 0

    def fresh_id(self) -> bytes:
        self.drawn += 1
        return id_of(1000 + self.drawn)

    def apply(self, deed: Deed, op_id: bytes, skip: int = 1) -> Result:
        self.index += skip
        command = Command(op_id=op_id, time_unix_nano=0, deed=deed)
        before = encode_snapshot(self.directory)
        result = self.directory.apply(self.index, command)
        again = decode_command(encode_command(command))
        assert encode_result(self.twin.apply(self.index, again)) == encode_result(result)
        assert encode_result(self.restored.apply(self.index, command)) == encode_result(result)
        if isinstance(result, Refused):
            assert self.without_index(before) == self.without_index(encode_snapshot(self.directory))
        return result

    @staticmethod
    def without_index(snapshot: bytes) -> Directory | bytes:
        directory = decode_snapshot(snapshot)
        directory.tables.index = 0
        return encode_snapshot(directory)

    op_ids = st.none() | st.integers(1, 6).map(id_of)

    @rule(name=channel_names, policy=policies, create=st.booleans(), host=host_names, new=incarnations, op_id=op_ids)
    def open(self, name: str, policy: Policy, create: bool, host: str, new: int, op_id: bytes | None) -> None:
        deed = OpenChannel(
            name=name, policy=policy, create=create, host_name=host, new_channel_id=self.fresh_id(), new_incarnation=new
        )
        self.apply(deed, op_id or self.fresh_id())

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
        deed = RegisterHost(
            host_id=host,
            name=name,
            gatekeepers=(Endpoint(target="h:1"),),
            boot_incarnation=boot,
            new_incarnation=new,
        )
        self.apply(deed, op_id or self.fresh_id(), skip)

    @rule(host=hosts, boot=boots)
    def deregister(self, host: bytes, boot: int) -> None:
        self.apply(DeregisterHost(host_id=host, boot_incarnation=boot), self.fresh_id())

    @rule(host=hosts, late=st.booleans(), tenure_off=st.sampled_from([0, 0, 1]))
    def expire(self, host: bytes, late: bool, tenure_off: int) -> None:
        held = self.directory.tables.hosts.get(host)
        deed = ExpireHost(
            host_id=host,
            boot_incarnation=held.boot_incarnation if held else 1,
            registered_index=(held.registered_index if held else 1) - late,
            tenure=self.directory.tenure + tenure_off,
        )
        self.apply(deed, self.fresh_id())

    @rule(tenure=st.integers(1, 5))
    def begin_tenure(self, tenure: int) -> None:
        before = self.directory.tenure
        deed = BeginTenure(tenure=tenure, supernode_id="s", new_cluster_id=f"c{tenure}", new_lease_ttl_nanos=tenure)
        self.apply(deed, self.fresh_id())
        assert self.directory.tenure == max(before, tenure)

    @rule()
    def restore(self) -> None:
        self.restored = decode_snapshot(encode_snapshot(self.restored))

    def some_channel(self, which: int) -> Channel | None:
        channels = [self.directory.tables.channels[one] for one in sorted(self.directory.tables.channels)]
        return channels[which % len(channels)] if channels else None

    @invariant()
    def all_replicas_agree(self) -> None:
        assert encode_snapshot(self.directory) == encode_snapshot(self.twin) == encode_snapshot(self.restored)
        assert self.writer.write(self.directory) == encode_snapshot(self.directory), "what is kept is not outdated"

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
            assert host.alive or owned, "a gone host without channels is forgotten"
        assert {channel.host_id for channel in tables.channels.values()} <= set(tables.hosts)

    @invariant()
    def an_epoch_never_falls_and_an_incarnation_changes_only_with_it(self) -> None:
        now = {one: (c.epoch, c.incarnation) for one, c in self.directory.tables.channels.items()}
        for one, (epoch, incarnation) in now.items():
            held_epoch, held_incarnation = self.epochs.get(one, (epoch, incarnation))
            assert epoch >= held_epoch
            assert (epoch == held_epoch) == (incarnation == held_incarnation) or epoch > held_epoch + 1
            assert incarnation != 0
        self.epochs |= now

    @invariant()
    def a_watcher_that_follows_the_changes_sees_the_channels_as_they_are(self) -> None:
        page = self.directory.tables.changes.read(self.position, 10_000)
        assert page is not None
        self.position = page.position
        for change in page.changes:
            if isinstance(change.subject, Channel):
                if change.kind is ChangeKind.REMOVED:
                    del self.mirror[change.subject.channel_id]
                else:
                    self.mirror[change.subject.channel_id] = change.subject
        assert self.mirror == self.directory.tables.channels


TestDirectory = DirectoryMachine.TestCase
TestDirectory.settings = settings(max_examples=60, stateful_step_count=40, deadline=None, database=None)
