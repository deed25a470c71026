"""A channel as a group shows it (paper, section 3.3)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.group_members import GroupMembers
from stampede_rt._async.past_cuts import cut_as_of
from stampede_rt._async.reader import Reader
from stampede_rt._async.reads import read_as_of
from stampede_rt.errors import ChannelNotFound, GroupNotFound
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import SeenCut
from stampede_rt.values.past import PastCut, add_reason
from stampede_rt.values.reading import ReadQuery


class GroupChannel(Reader):
    """A descriptor: a channel as a group shows it. It shows only items before the cut, and its NOW is the cut.

    It reads like the channel. The channel itself stays as it is, and still shows all items. A descriptor cannot put.
    """

    def __init__(self, group: GroupMembers, state: ChannelState) -> None:
        super().__init__(group.session, state, group.view)
        self._group = group

    async def _read(self, query: ReadQuery) -> Items:
        if query.as_of is not None:
            return (await read_at_past_cut(self._group, self._state, query, query.as_of))[0]
        floor = self._group.view.cut_floor
        try:
            items = await super()._read(query)
        except GroupNotFound:
            await self._group.refresh()  # also looks for the group by its name; raises GroupNotFound if there is none
            return await super()._read(query)
        if floor is None or (items.cut is not None and items.cut >= floor):
            return items
        # The host's cut is lower than the cut that this process saw: the group may have begun anew.
        await self._group.refresh()
        return await super()._read(query) if self._group.view.cut_floor is None else items

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, through group {self._group.name!r}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return self._session.reopened("descriptor", self._group, self.name, self._state.coding)


async def read_at_past_cut(
    group: GroupMembers, state: ChannelState, query: ReadQuery, as_of: int
) -> tuple[Items, PastCut]:
    """Read a channel at the group's cut as of an instant. The cut that the process has seen does not change."""
    try:
        past = await cut_as_of(group, as_of)
    except (ChannelNotFound, GroupNotFound):
        await group.refresh()
        past = await cut_as_of(group, as_of)
    query = replace(query, cut=past.cut)
    items = await read_as_of(group.session, state, query, as_of, SeenCut(group.info.group_id))
    return add_reason(items, past.reason), past
