"""The losses of owners that a subscription to a recorded channel must report, because its reader does not know them."""

from __future__ import annotations

from typing import Any

from stampede_rt.values.seq_starts import begin_of, is_start
from stampede_rt.values.timeline import Interval
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.channels.archive_reach import ArchiveReach
from stampede_rt_channel_host.channels.past_reads import tried
from stampede_rt_channel_host.core.channel import ChannelCore, Query


class ArchivedLosses:
    """The losses that one channel's archive shows, and the loss before the present owner."""

    def __init__(
        self, archive: HostArchive, recorder: ChannelRecorder, reach: ArchiveReach, channel: ChannelCore
    ) -> None:
        self._archive, self._recorder, self._reach, self._channel = archive, recorder, reach, channel

    async def places(self, where: dict[str, Any], now: int) -> list[int]:
        """The first seqs of the owners that followed a lost one, if a subscription that begins at `where` must report
        these losses. The reader wants items from before the end of the loss.

        `where` are keyword arguments of `ChannelCore.subscribing_all`. Raises Unavailable if the archive cannot
        be read.
        """
        start, saved = where.get("start"), where.get("saved")
        if not is_start(begin_of(1, self._channel.next_seq + 1)):
            return []
        if start is not None:
            found = self._reach.resolved_start(Query(interval=Interval(start, start)), now)
            return [] if found is None else await self._after(found[0], 0)
        if saved is None or saved.low is None or saved.incarnation != self._channel.incarnation:
            return []
        return await self._after(saved.low[0], saved.next_seq)

    async def _after(self, since: int, seq: int) -> list[int]:
        """The places of the losses that ended after the instant `since`, above the seq `seq`."""
        files, lost_before = self._recorder.files, self._channel.lost_before
        found = await tried(lambda: self._archive.in_reader(files.losses, self._recorder.segments, since))
        places = {one.begin for one in found}
        latest = begin_of(1, self._channel.next_seq + 1)
        if lost_before is not None and lost_before <= since:  # a file that does not record the loss has a later instant
            places.discard(latest)
        elif lost_before is not None and (not places or self._recorder.archived_to <= latest):
            places.add(latest)  # no file shows the loss
        return sorted(one for one in places if one > seq)
