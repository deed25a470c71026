"""Hosts with channels and groups over them, and for each host an oracle with the messages that this host got.

Every channel is a ChannelPair, so that its own oracle checks that groups do not affect it. The readers of descriptors
are in `readers`, and the readers of whole groups in `listeners`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore
from stampede_rt_channel_host.core.group import (
    ChannelTimes,
    GroupCut,
    GroupDefinition,
    Horizon,
    OwnChannelTimes,
    TimesBoard,
)
from tests.oracle.group import OracleBoard, OracleGroup, OracleMember
from tests.property.channel_pair import INCARNATION, ChannelPair

CHANNELS = (b"a", b"b", b"c")


@dataclass
class LivingPair(ChannelPair):
    """A channel in one of its incarnations. A lost channel begins again, empty."""

    incarnation: int = INCARNATION

    def __post_init__(self) -> None:
        super().__post_init__()
        self.core = ChannelCore(self.policy, incarnation=self.incarnation, name="pair")


@dataclass
class OwnedChannel:
    """A channel and its owner.

    `own` and `member`: its times at the owner, in the core and in the oracle, while a group has it.
    """

    pair: LivingPair
    owner: int
    epoch: int = 1
    own: OwnChannelTimes | None = None
    member: OracleMember | None = None


class Host:
    """The knowledge of one host, in the core and in the oracle.

    `told_by`: the hosts that have sent this host all their knowledge since it began.
    """

    def __init__(self, definitions: Sequence[GroupDefinition]) -> None:
        self.is_up = True
        self.board, self.oracle_board = TimesBoard(), OracleBoard()
        self.told_by: set[int] = set()
        self.deaf_owner_of: set[bytes] = set()  # channels that it has lost to another owner without knowing it yet
        self.cuts = [GroupCut(one, self.board) for one in definitions]
        self.oracles = [self._oracle(one) for one in definitions]
        self.last_cuts: list[int | None] = [None for _ in definitions]

    def _oracle(self, wanted: GroupDefinition) -> OracleGroup:
        return OracleGroup(
            self.oracle_board, wanted.members, wanted.reference, wanted.by_end, wanted.max_lead_nanos,
            wanted.idle_after_nanos,
        )  # fmt: skip

    def define(self, group: int, definition: GroupDefinition) -> None:
        self.cuts[group].define(definition)
        self.oracles[group].members = definition.members

    def begin_anew(self, group: int, definition: GroupDefinition) -> None:
        self.define(group, definition)
        self.oracles[group] = self._oracle(definition)
        self.last_cuts[group] = None

    def horizon(self, group: int) -> Horizon:
        return Horizon(self.cuts[group].cut, lambda: "somebody holds it back")

    def confirm(self, others: set[int]) -> None:
        """Confirm the cuts once all live hosts have told this host everything."""
        for cut, oracle in zip(self.cuts, self.oracles, strict=True):
            if not cut.is_confirmed and others <= self.told_by:
                cut.confirm()
                oracle.is_confirmed = True

    def look(self, clock: int) -> None:
        """Check that every cut moves as the oracle's does, and never back."""
        for group, (cut, oracle) in enumerate(zip(self.cuts, self.oracles, strict=True)):
            before = cut.cut
            oracle.observe(clock)
            assert cut.refresh(clock) == (cut.cut != before)
            last = self.last_cuts[group]
            assert last is None or (cut.cut is not None and cut.cut >= last)
            self.last_cuts[group] = cut.cut
            self._agree(cut, oracle, clock)

    def _agree(self, cut: GroupCut, oracle: OracleGroup, clock: int) -> None:
        assert cut.cut == oracle.cut
        assert cut.is_confirmed == oracle.is_confirmed
        assert cut.waiting_on(clock) == oracle.waiting_on(clock)
        assert cut.next_idle(clock) == oracle.next_idle(clock)
        for member in cut.members(clock):
            assert member.cut == oracle.cut_of(member.channel_id)
            assert member.mark == oracle.mark_of(member.channel_id)
            assert member.is_idle == oracle.is_idle(member.channel_id, clock)


@dataclass
class World:
    """`put`, `tick`, `migrate` and other methods change the world. After each change, `look` moves the cuts and checks
    the rules.

    Hosts may receive late of each other and of their own channels. The channels of a lost host begin again at another
    host.
    """

    policies: list[Policy]
    definitions: list[GroupDefinition]
    hosts_count: int
    clock: int
    placed: dict[bytes, OwnedChannel] = field(init=False)
    hosts: list[Host] = field(init=False)
    is_plain: list[bool] = field(init=False)  # no change has made a group's cut smaller than it could be
    reached: list[int | None] = field(init=False)  # the cut of an observer that sees all channels at the same time

    def __post_init__(self) -> None:
        self.placed = {
            one: OwnedChannel(LivingPair(policy, self.clock), at % self.hosts_count)
            for at, (one, policy) in enumerate(zip(CHANNELS, self.policies, strict=True))
        }
        self.hosts = [Host(self.definitions) for _ in range(self.hosts_count)]
        self.is_plain = [not one.by_end and one.idle_after_nanos is None for one in self.definitions]
        self.reached = [None for _ in self.definitions]
        self.follow()
        self.exchange()
        self.look()

    @property
    def up(self) -> list[int]:
        return [at for at, host in enumerate(self.hosts) if host.is_up]

    @property
    def followed(self) -> set[bytes]:
        """The channels that belong to a group."""
        return set().union(*(one.members for one in self.definitions))

    def pair(self, channel_id: bytes) -> LivingPair:
        return self.placed[channel_id].pair

    def host_of(self, channel_id: bytes) -> Host:
        return self.hosts[self.placed[channel_id].owner]

    def follow(self) -> None:
        """Let owners follow the times of their channels that belong to groups, and of no others."""
        followed = self.followed
        for channel_id, one in self.placed.items():
            if channel_id not in followed:
                one.own = one.member = None
            elif one.own is None:
                one.pair.oracle.age(self.clock)
                one.own = OwnChannelTimes(one.pair.core, self.clock)
                one.member = OracleMember(one.pair.oracle, one.epoch, one.pair.incarnation, self.clock)
        for host in self.hosts:
            for channel_id in self.placed.keys() - followed:
                host.board.forget(channel_id)
            received = host.oracle_board.received
            host.oracle_board.received = {one: received[one] for one in received if one in followed}

    def note_change(self, channel_id: bytes) -> None:
        """Note that the channel may have got items or an advance."""
        one = self.placed[channel_id]
        one.pair.oracle.age(self.clock)
        if one.own is not None and one.member is not None:
            one.own.observe(self.clock)
            one.member.observe(self.clock)

    def look(self) -> None:
        """Let every host process the times of its own channels, and move its cuts."""
        for at, host in enumerate(self.hosts):
            for channel_id, one in self.placed.items():
                if one.own is None or one.member is None or not host.is_up:
                    continue
                if one.owner == at:
                    host.board.enter_own(channel_id, one.own.times(one.epoch), one.own.silent_since)
                    host.oracle_board.own(channel_id, one.member)
                elif channel_id in host.deaf_owner_of:
                    stale = ChannelTimes(one.epoch - 1, one.pair.incarnation, 2**61, 2**62, 2**61)
                    if (known := host.board.find(channel_id)) is not None and known.times.epoch >= one.epoch:
                        host.board.enter_own(channel_id, stale, self.clock)
            if host.is_up:
                host.confirm(set(self.up) - {at})
                host.look(self.clock)
        self._look_at_all()

    def _look_at_all(self) -> None:
        """Check that no host shows more than an observer that sees all channels at the same time."""
        for group, wanted in enumerate(self.definitions):
            counting = wanted.members if wanted.reference is None else [wanted.reference]
            marks = [self._mark(one) for one in counting]
            known = [mark for mark in marks if mark is not None]
            if len(known) == len(marks):
                self.reached[group] = max([min(known), *[one for one in [self.reached[group]] if one is not None]])
            for host in self.hosts:
                cut, most = host.cuts[group].cut, self.reached[group]
                assert not self.is_plain[group] or cut is None or (most is not None and cut <= most)

    def _mark(self, channel_id: bytes) -> int | None:
        channel = self.pair(channel_id).oracle
        advance = [] if channel.advanced_to is None else [channel.advanced_to]
        return max([*advance, *(one.time for one in channel.log.values())], default=None)

    def exchange(self) -> None:
        """Deliver all messages between the hosts: times, cut floors and signs of life."""
        for sender in self.up:
            for receiver in self.up:
                if receiver != sender:
                    self.send_times(sender, receiver)

    def send_times(self, sender: int, receiver: int) -> None:
        sending_host, receiving_host = self.hosts[sender], self.hosts[receiver]
        for channel_id, one in self.placed.items():
            known = sending_host.board.find(channel_id)
            if one.owner != sender or known is None:
                continue
            receiving_host.board.receive(channel_id, known.times, known.silent_nanos(self.clock), self.clock)
            receiving_host.oracle_board.receive(channel_id, sending_host.oracle_board.received[channel_id], self.clock)
        receiving_host.board.confirm([one for one in CHANNELS if self.placed[one].owner == sender], self.clock)
        for group, cut in enumerate(sending_host.cuts):
            floor = cut.cut
            if floor is not None:
                receiving_host.cuts[group].merge_floor(floor)
                receiving_host.oracles[group].raise_to(floor)
        receiving_host.told_by.add(sender)

    def agree(self) -> None:
        """Check that all hosts show the same once each has told each other everything.

        If no item can be missing, they show all items.
        """
        for _ in range(3):
            self.exchange()
            self.look()
        for group, most in enumerate(self.reached):
            assert len({self.hosts[at].cuts[group].cut for at in self.up}) == 1
            if self.is_plain[group]:
                assert self.hosts[self.up[0]].cuts[group].cut == most

    def change_member(self, group: int, channel_id: bytes, *, joins: bool) -> bool:
        """Add or remove a member at all hosts together.

        The reference and the last member stay. Returns whether the change was possible.
        """
        former = self.definitions[group]
        wanted = former.members | {channel_id} if joins else former.members - {channel_id}
        if not wanted or former.reference not in {None, *wanted} or wanted == former.members:
            return False
        self._define(group, replace(former, members=frozenset(wanted), spec_version=former.spec_version + 1))
        return True

    def _define(self, group: int, definition: GroupDefinition) -> None:
        self.definitions[group] = definition
        self.is_plain[group] = False
        for host in self.hosts:
            host.define(group, definition)
        self.follow()

    def migrate(self, channel_id: bytes, to: int, *, is_received: bool) -> bool:
        """Move a channel to another host.

        Unless `is_received`, the former owner learns of the move from the new owner. Returns whether the channel moved.
        """
        one = self.placed[channel_id]
        if to == one.owner or not self.hosts[to].is_up:
            return False
        former = self.hosts[one.owner]
        if is_received:
            former.board.disown(channel_id, self.clock)
            former.oracle_board.disown(channel_id, self.clock)
        else:
            former.deaf_owner_of.add(channel_id)
        self._take_up(channel_id, one.pair, to)
        return True

    def _take_up(self, channel_id: bytes, pair: LivingPair, by: int) -> None:
        self.hosts[by].deaf_owner_of.discard(channel_id)
        self.placed[channel_id] = OwnedChannel(pair, by, self.placed[channel_id].epoch + 1)
        self.follow()

    def lose(self, host: int, successor: int) -> list[bytes]:
        """Lose a host with all its channels. Another host begins the channels again. Returns these channels.

        One of several hosts always stays. A single host is back immediately. A group whose cut floor no host knows
        begins anew.
        """
        lost = [one for one in CHANNELS if self.placed[one].owner == host]
        self.hosts[host] = Host(self.definitions)
        self.hosts[host].is_up = successor == host
        for other in self.hosts:
            other.told_by.discard(host)
        for group, former in enumerate(self.definitions):
            if not any(self.hosts[at].cuts[group].is_confirmed for at in self.up):
                self._begin_anew(group, replace(former, incarnation=former.incarnation + 1))
        for channel_id in lost:
            former_pair = self.pair(channel_id)
            life = former_pair.incarnation + 1
            self._take_up(channel_id, LivingPair(former_pair.policy, self.clock, incarnation=life), successor)
        self.is_plain = [False for _ in self.is_plain]
        return lost

    def _begin_anew(self, group: int, definition: GroupDefinition) -> None:
        self.definitions[group] = definition
        for host in self.hosts:
            host.begin_anew(group, definition)

    def bring_back(self, host: int) -> None:
        """Bring back a lost host, which knows nothing."""
        if not self.hosts[host].is_up:
            self.hosts[host] = Host(self.definitions)

    def deliver_stale_message(self, channel_id: bytes) -> None:
        """Deliver an old message of a former owner, and check that it changes nothing."""
        one = self.placed[channel_id]
        for host in self.hosts:
            if (known := host.board.find(channel_id)) is not None and known.times.epoch == one.epoch:
                far = ChannelTimes(one.epoch - 1, one.pair.incarnation, 2**61, 2**62, 2**61)
                assert not host.board.receive(channel_id, far, 0, self.clock)

    def check(self) -> None:
        """Check that the original channels are as if there were no group."""
        for one in self.placed.values():
            one.pair.check()
