# Generated from ../_async by tools/generate.py; do not edit.
"""Reads of all members of a group at one cut, even if several hosts own them."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import NamedTuple

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.group_members import GroupMembers
from stampede_rt._sync.past_cuts import cut_as_of
from stampede_rt._sync.present_cuts import present_cut
from stampede_rt._sync.reads import read
from stampede_rt.transports.concurrency_sync import run_all
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import ByChannel, SeenCut
from stampede_rt.values.model import Reason
from stampede_rt.values.past import add_reason
from stampede_rt.values.reading import ReadQuery


class MemberAnswers(NamedTuple):
    """The answer of each member at one cut. `reason`: why the cut may have been higher; None: the cut is exact."""

    answers: ByChannel[Channel, Items]
    reason: Reason | None


def read_members(group: GroupMembers, query: ReadQuery) -> MemberAnswers:
    """Read all members at the present cut, or with `as_of` at the cut of that instant. Raises as `read` does."""
    view, reason = group.view, None
    if query.as_of is None:
        query = replace(query, cut=present_cut(group))
    else:
        view = SeenCut(group.info.group_id)  # without the present cut, which is later
        cut, reason, _ = cut_as_of(group, query.as_of)
        query = replace(query, cut=cut)
    channels = group.channels
    found = run_all([functools.partial(read, group.session, one._state, query, view) for one in channels])
    ids = (channel.info.channel_id for channel in channels)
    answers = (add_reason(items, reason) for items in found)
    return MemberAnswers(ByChannel(channels, dict(zip(ids, answers, strict=True))), reason)
