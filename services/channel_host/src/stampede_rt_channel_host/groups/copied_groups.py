"""Groups as a copy of one of their members shows them (paper, section 4.1: proxies).

A host with a copy computes no cut. The feed of the copy brings the cut at the owner, together with the items before
this cut.
"""

from __future__ import annotations

import asyncio

from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.observers import Observers
from stampede_rt_channel_host.core.group import CutFloor, GroupDefinition, Horizon
from stampede_rt_channel_host.core.records import RecordedGroup
from stampede_rt_channel_host.groups.group_directory import GroupDirectory
from stampede_rt_channel_host.groups.hosted_group import NOTHING_VISIBLE, began_anew

RECORDS_MAX = 10_000
RECORD_SECONDS = 10.0  # after this time the host asks the directory for the group again


class CopiedGroup:
    """One group, as the copy `hosted` shows it."""

    def __init__(self, record: RecordedGroup, hosted: HostedChannel, state: CopyState) -> None:
        self.record = record
        self.cut_observers = Observers()  # unused: each part of the feed wakes the readers of the copy
        self._hosted = hosted
        self._state = state

    @property
    def definition(self) -> GroupDefinition:
        """The members and settings of the group."""
        return self.record.definition

    @property
    def _floor(self) -> CutFloor | None:
        floor = self._state.floors.get(self.record.group_id)
        return floor if floor is not None and floor.incarnation == self.record.incarnation else None

    def has_reached(self, cut: int | None) -> bool:
        """Whether the copy knows the group's cut, and the cut is at or beyond `cut`."""
        floor = self._floor
        return floor is not None and (cut in (None, NOTHING_VISIBLE) or floor.cut >= cut)

    async def reach(self, cut: int | None, seconds_max: float) -> bool:
        """Wait until the copy has reached `cut` (None: any cut). Raises StaleBinding (MOVED) after `seconds_max`."""
        if not await self._state.wait_for(lambda: self.has_reached(cut), seconds_max):
            raise refusals.copy_cannot(
                self._hosted.record.name, f"does not know the cut of group {self.record.name} that the read needs"
            )
        return True

    def horizon(self, cut: int | None = None) -> Horizon:
        """The present horizon of the group at the copy, or its horizon at an earlier `cut`."""
        floor = self._floor
        at = (None if floor is None else floor.cut) if cut is None else cut
        return Horizon(None if at == NOTHING_VISIBLE else at, self.held_by)

    def held_by(self) -> str:
        """Returns a phrase for error texts, which says how long the cut is held back."""
        return "until the owner of the channel has told its copy a later cut"

    def check_incarnation(self, incarnation: int) -> None:
        """Raises IncarnationLost if the group has begun anew since `incarnation`."""
        floor = self._state.floors.get(self.record.group_id)
        if floor is not None and floor.incarnation != incarnation:
            raise began_anew(self.record)


class CopiedGroups:
    """Finds the groups of copies. Keeps the directory's records for a while."""

    def __init__(self, directory: GroupDirectory) -> None:
        self._directory = directory
        self._records: dict[bytes, tuple[RecordedGroup, float]] = {}

    async def find(self, group_id: bytes, hosted: HostedChannel) -> CopiedGroup:
        """The group as the copy `hosted` shows it.

        Raises GROUP_NOT_FOUND, Unavailable, and StaleBinding if `hosted` is no longer a copy.
        """
        state = hosted.copy
        if state is None:
            raise refusals.copy_cannot(hosted.record.name, "is removed")
        record, until_s = self._records.get(group_id, (None, 0.0))
        floor = state.floors.get(group_id)
        is_old = record is None or (
            floor is not None and (floor.spec_version > record.spec_version or floor.incarnation != record.incarnation)
        )
        if record is None or is_old or until_s < asyncio.get_running_loop().time():
            record = (await self._directory.resolve(group_id)).group
            if len(self._records) >= RECORDS_MAX:
                self._records.clear()
            self._records[group_id] = record, asyncio.get_running_loop().time() + RECORD_SECONDS
        return CopiedGroup(record, hosted, state)
