"""Matches of recorded channels: reads the archived items that a matcher needs, and the archived items of its
matches.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.archive import ArchivedRead
from stampede_rt_channel_host.core.channel import Query
from stampede_rt_channel_host.core.group import FoundMatch, ItemsNotLoaded, archived_item, found_item


async def load(channels: ChannelStore, hosted: HostedChannel, missing: ItemsNotLoaded) -> None:
    """Load the archived items that a search needs. Raises Unavailable if the archive cannot be read."""
    reads = missing.reads()
    query = next(reads, None)
    while query is not None:
        found = await _read(channels, hosted, query)
        try:
            query = reads.send(found)
        except StopIteration:
            return


async def filled(channels: ChannelStore, near: Mapping[bytes, HostedChannel], found: FoundMatch) -> FoundMatch:
    """The match with its archived items. If an item has left the archive, its `NearestItem` in the match has no `item`.

    Raises Unavailable if an archive cannot be read.
    """
    matched = dict(found.matched)
    for member in found.archived:
        one = matched[member]
        read = await _read(channels, near[member], archived_item(one.time, one.seq))
        matched[member] = one._replace(item=found_item(read), is_archived=False)
    return replace(found, matched=matched)


async def _read(channels: ChannelStore, hosted: HostedChannel, query: Query) -> ArchivedRead:
    recording = hosted.recording
    if recording is None:
        raise Unavailable(f"channel {hosted.record.name} is not recorded any more; subscribe again")
    return await recording.read(query, None, channels.scheduler, channels.now)
