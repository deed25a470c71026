# Generated from ../_async by tools/generate.py; do not edit.
"""A channel as a group shows it (paper, section 3.3)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.group_members import GroupMembers
from stampede_rt._sync.past_cuts import cut_as_of
from stampede_rt._sync.reader import Reader
from stampede_rt._sync.reads import read
from stampede_rt.errors import GroupNotFound
from stampede_rt.values.grouping import SeenCut
from stampede_rt.values.model import Items
from stampede_rt.values.reading import ReadQuery


class GroupChannel(Reader):
    """A descriptor: a channel as a group shows it. It shows only items before the cut, and its NOW is the cut.

    It reads like the channel. The channel itself stays as it is, and still shows all items. A descriptor cannot put.
    """

    def __init__(self, group: GroupMembers, state: ChannelState) -> None:
        super().__init__(group.session, state, group.view)
        self._group = group

    def _read(self, query: ReadQuery) -> Items:
        if query.as_of is not None:
            return self._read_as_of(query, query.as_of)
        floor = self._group.view.cut_floor
        try:
            items = super()._read(query)
        except GroupNotFound:
            self._group.refresh()  # also looks for the group by its name; raises GroupNotFound if there is none
            return super()._read(query)
        if floor is None or (items.cut is not None and items.cut >= floor):
            return items
        self._group.refresh()  # the host has a lower cut than this process saw: the group may have begun anew
        return super()._read(query) if self._group.view.cut_floor is None else items

    def _read_as_of(self, query: ReadQuery, as_of: int) -> Items:
        """Read at the cut of then. This changes nothing about the cut that the process has seen."""
        query = replace(query, cut=cut_as_of(self._group, as_of))
        return read(self._session, self._state, query, SeenCut(self._group.info.group_id))

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, through group {self._group.name!r}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return self._session.reopened("descriptor", self._group, self.name, self._state.coding)
