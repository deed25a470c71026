"""Gets of recorded channels through a group: they read the archive, and memory, up to the cut."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt.values.timeline import ResolvedInterval
from stampede_rt_channel_host.channels.group_access import GroupAnswer, GroupReadParams
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import Query
from stampede_rt_channel_host.core.group import Horizon, RecordedView


class FoundAnswer(NamedTuple):
    """The answer of a get, and the view that says at which cut the answer changes."""

    answer: GroupAnswer
    view: RecordedView


def reads_archive(params: GroupReadParams, hosted: HostedChannel, query: Query, horizon: Horizon, now: int) -> bool:
    """Whether the answer may have items that only the archive of the channel has."""
    recording = hosted.recording
    return recording is not None and not params.within_memory and recording.reaches_in_group(query, horizon, now)


async def read_recorded_in_group(
    channels: ChannelStore,
    hosted: HostedChannel,
    query: Query,
    horizon: Horizon,
    within: ResolvedInterval | None,
    *,
    waits: bool,
) -> FoundAnswer:
    """The present answer. `within`: the interval as resolved before; None: not yet."""
    recording = hosted.recording
    assert recording is not None, "the channel is recorded"
    view = await recording.read_in_group(query, horizon, within, channels.scheduler, channels.now, waits=waits)
    return FoundAnswer(GroupAnswer(view.answer, horizon.cut, view.continues), view)


def is_over(view: RecordedView, query: Query) -> bool:
    """Whether a get that may wait has its answer."""
    return view.answer.complete or (bool(view.answer.slices) and not query.complete)
