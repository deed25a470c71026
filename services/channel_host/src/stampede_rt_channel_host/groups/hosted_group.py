"""One group at a host: the directory's record, the cut, its waiting callers and its readers."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Collection
from operator import itemgetter
from typing import Any

from sortedcontainers import SortedKeyList

from stampede_rt.errors import StampedeError, error_for
from stampede_rt.values.timeline import MIN_INSTANT
from stampede_rt_channel_host.channels.observers import OBSERVERS_PER_PIECE, ChannelObserver, Observers
from stampede_rt_channel_host.core.channel import Pieces, batched
from stampede_rt_channel_host.core.channel.limits import DEFAULT_MAX_FUTURE_NANOS
from stampede_rt_channel_host.core.group import CutFloor, CutMember, GroupCut, GroupDefinition, Horizon, TimesBoard
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedGroup, ResolvedGroup

_WHY_ANEW = (
    "every host that knew its cut from the beginning has restarted or was lost since then, together or one after "
    "another, so the former cut may be lost"
)
NOTHING_VISIBLE = MIN_INSTANT  # the wire value for a group that has no cut yet
_TIMER_SECONDS_MIN = 0.001
_arrivals = itertools.count()


class HostedGroup:
    """One group at this host.

    `record` is the latest record from the directory. `owners` gives each member's host, `targets` the addresses of the
    live hosts. `awaited_hosts`: the live hosts that own members and have not reported their cut. A new group shows
    nothing until all of them have reported it.

    The group wakes `cut_observers` and `gets` when it shows more or when members or owners change. It wakes
    `member_observers` after each change of a member. `generation` grows whenever members, their hosts, or the members
    served here may have changed.
    """

    def __init__(
        self,
        resolved: ResolvedGroup,
        board: TimesBoard,
        now: Callable[[], int],
        *,
        on_moved: Callable[[bytes], None],
        on_idle: Callable[[bytes], None],
        begin: Callable[[Pieces[None]], None],
    ) -> None:
        """Set up the group.

        The group calls `on_moved` whenever the cut has moved, and `on_idle` with each member of this host that becomes
        idle. `begin` does long work for which no caller waits (`PieceScheduler.begin`).
        """
        self.cut = GroupCut(resolved.group.definition, board)
        self.cut_observers = Observers(begin)
        self.member_observers = Observers(begin)
        self.gets: dict[object, ChannelObserver] = {}  # by channel: the object with the blocked gets of that channel
        # the floors that callers wait for, with their futures
        self._floor_waits: Any = SortedKeyList(key=itemgetter(0, 1))
        self._is_releasing = False
        self._begin = begin
        self.awaited_hosts: set[bytes] = set()
        self.generation = 0
        # loop time of the last answer of the directory, and of the last request that named the group
        self.looked_up_s = 0.0
        self.named_s = 0.0
        self.is_stale = False  # the directory may have a newer version of the group
        self._now = now
        self._on_moved = on_moved
        self._on_idle = on_idle
        # at the last `changed`: the cut, whether it was confirmed, and the generation
        self._shown: tuple[int | None, bool, int] = None, False, 0
        self._idle_timer: asyncio.TimerHandle | None = None
        self.adopt(resolved)

    def adopt(self, resolved: ResolvedGroup) -> bool:
        """Take over the directory's record. Returns True if the group, and so its readers, must begin anew."""
        anew = resolved.group.incarnation != self.cut.definition.incarnation
        self.record: RecordedGroup = resolved.group
        self.owners: dict[bytes, bytes] = {one: record.host_id for one, record in resolved.channels.items()}
        self.channels = resolved.channels
        self.targets = resolved.targets
        self.host_names = resolved.host_names
        self._owner_ids = frozenset(self.owners.values())
        definition = resolved.group.definition
        self._lead_nanos = definition.max_lead_nanos + max(map(_future_nanos, resolved.channels.values()), default=0)
        self.cut.define(definition)
        self.generation += 1
        return anew

    @property
    def definition(self) -> GroupDefinition:
        """The members and settings of the group."""
        return self.cut.definition

    def check_incarnation(self, incarnation: int) -> None:
        """Raises IncarnationLost if the group has begun anew since `incarnation`.

        Readers call this before each read: a group that begins anew ends some of its readers only a moment later.
        """
        if self.record.incarnation != incarnation:
            raise began_anew(self.record)

    def merge_floor(self, host_id: bytes, floor: CutFloor) -> bool:
        """Process another host's floor, if it is plausible. Returns True if this raised the cut.

        A floor is plausible if the host owns a member, and if the floor is not too far ahead of this host's clock. A
        member accepts items and advances up to its `max_future` ahead of the clock. A cut lies at most `max_lead` after
        them.
        """
        if host_id not in self._owner_ids or floor.incarnation != self.record.incarnation:
            return False
        if floor.cut > self._now() + self._lead_nanos:
            return False
        return self.cut.merge_floor(floor.cut)

    def horizon(self, cut: int | None = None) -> Horizon:
        """The present horizon of the group, or its horizon at an earlier `cut`."""
        if cut == NOTHING_VISIBLE:
            return Horizon(None, self.held_by)
        return Horizon(self.cut.cut if cut is None else cut, self.held_by)

    def held_by(self) -> str:
        """The members or hosts that hold the cut back, as a phrase for error texts."""
        if not self.cut.is_confirmed:
            hosts = (
                ", ".join(sorted(self.host_names.get(one, one.hex()) for one in self.awaited_hosts)) or "the directory"
            )
            return f"until {hosts} has reported its position"
        names = [self.name_of(one) for one in self.cut.waiting_on(self._now())]
        return f"held back by {', '.join(names)}" if names else "because its members have not registered again yet"

    def waiting_on(self) -> list[bytes]:
        """The members that hold the cut back. If hosts have not reported their cuts yet: the members at those hosts."""
        unreported = sorted(channel_id for channel_id, host_id in self.owners.items() if host_id in self.awaited_hosts)
        return unreported if unreported and not self.cut.is_confirmed else self.cut.waiting_on(self._now())

    def ownerless(self) -> list[bytes]:
        """The members whose host has lost its lease. Producers can put into them only after they get another host."""
        return [channel_id for channel_id, host_id in self.owners.items() if host_id not in self.targets]

    def name_of(self, channel_id: bytes) -> str:
        """A member's name, for people."""
        return self.channels[channel_id].name if channel_id in self.channels else channel_id.hex()

    def members(self) -> list[CutMember]:
        """The present state of all members."""
        return list(self.cut.members(self._now()))

    def members_to_watch(self) -> Collection[bytes]:
        """The members whose changes may concern the group or its observers, as of the last `changed`."""
        if self.member_observers or self.cut.definition.idle_after_nanos is not None:
            return self.cut.definition.members
        holder = self.cut.holder
        return () if holder is None else (holder,)

    def changed(self) -> None:
        """Compute the cut again after a change of a member or of its times, and wake the observers concerned."""
        if self.cut.refresh(self._now()):
            self._on_moved(self.record.group_id)
        shown = self.cut.cut, self.cut.is_confirmed, self.generation
        has_changed, self._shown = shown != self._shown, shown
        self._release_reached()
        if has_changed:
            for gets in [*self.gets.values()]:
                gets.wake()
            self.cut_observers.wake()
        self.member_observers.wake()
        self._set_idle_timer()

    def end(self, error: StampedeError) -> None:
        """End the waits of the group's callers and the streams of its readers with `error`.

        If there are many, the last ones end a moment later.
        """
        self._begin(self.ending(error))

    def ending(self, error: StampedeError) -> Pieces[None]:
        """Like `end`, but in pieces, for the callers and readers that are there when it begins."""
        if self._idle_timer is not None:
            self._idle_timer.cancel()
        for gets in [*self.gets.values()]:
            gets.end(error)
        waits = [reached for _, _, reached in self._floor_waits]
        cut_ends, member_ends = self.cut_observers.ending(error), self.member_observers.ending(error)
        yield from cut_ends
        yield from member_ends
        for part in batched(waits, OBSERVERS_PER_PIECE):
            yield
            for reached in part:
                if not reached.done():
                    reached.set_exception(error)

    async def reach(self, floor: int | None, timeout_s: float | None) -> bool:
        """Wait until the group's cut is confirmed and has reached `floor` (None: any cut). Returns True then.

        Returns False after `timeout_s`; None: no limit. Raises the error that ends the group.
        """
        if self.has_reached(floor):
            return True
        reached: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        waiting = (NOTHING_VISIBLE if floor is None else floor, next(_arrivals), reached)
        self._floor_waits.add(waiting)
        try:
            async with asyncio.timeout(timeout_s):
                await reached
        except TimeoutError:
            return self.has_reached(floor)
        finally:
            self._floor_waits.discard(waiting)
        return True

    def _release_reached(self) -> None:
        if self._floor_waits and not self._is_releasing and self.has_reached(self._floor_waits[0][0]):
            self._is_releasing = True
            self._begin(self._releasing())

    def _releasing(self) -> Pieces[None]:
        try:
            while self._release_some():
                yield
        finally:
            self._is_releasing = False

    def _release_some(self) -> bool:
        """Wake some callers. Returns True if other callers may be left to wake."""
        for _ in range(OBSERVERS_PER_PIECE):
            if not self._floor_waits or not self.has_reached(self._floor_waits[0][0]):
                return False
            _, _, reached = self._floor_waits.pop(0)
            if not reached.done():
                reached.set_result(None)
        return True

    def has_reached(self, floor: int | None) -> bool:
        """Whether the group's cut is confirmed and at or beyond `floor`."""
        cut = self.cut.cut
        return self.cut.is_confirmed and (floor in (None, NOTHING_VISIBLE) or (cut is not None and cut >= floor))

    def floor(self) -> CutFloor | None:
        """The cut at this host, as other hosts get it; None: there is no cut yet."""
        cut = self.cut.cut
        if cut is None:
            return None
        return CutFloor(
            group_id=self.record.group_id,
            incarnation=self.record.incarnation,
            cut=cut,
            spec_version=self.record.spec_version,
        )

    def _set_idle_timer(self) -> None:
        """Set the timer for the next member of this host that becomes idle, which may move the cut without a put."""
        if self._idle_timer is not None:
            self._idle_timer.cancel()
            self._idle_timer = None
        due = self.cut.next_idle(self._now())
        if due is not None:
            delay_s = max((due - self._now()) / 1e9, _TIMER_SECONDS_MIN)
            self._idle_timer = asyncio.get_running_loop().call_later(delay_s, self._note_idle_members)

    def _note_idle_members(self) -> None:
        self._idle_timer = None
        for member in self.members():
            if member.is_idle and member.known is not None and member.known.known_until is None:
                self._on_idle(member.channel_id)
        self.changed()


def began_anew(record: RecordedGroup) -> StampedeError:
    """The error for the readers of a group that began anew."""
    text = f"group {record.name} began anew: {_WHY_ANEW}; read it from now on"
    return error_for("INCARNATION_LOST", text, {"group": record.name})


def other_incarnation(record: RecordedGroup) -> StampedeError:
    """The error for a subscription that would start at a position of another incarnation of the group."""
    text = f"the position comes from another incarnation of group {record.name}, which began anew: {_WHY_ANEW}"
    return error_for("INCARNATION_LOST", f"{text}; subscribe from now on", {"group": record.name})


def _future_nanos(channel: RecordedChannel) -> int:
    """How far ahead of its host's clock the channel accepts items, in nanoseconds."""
    stated = channel.policy.max_future_nanos
    return DEFAULT_MAX_FUTURE_NANOS if stated is None else stated
