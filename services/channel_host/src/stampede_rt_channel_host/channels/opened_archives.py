"""Opens the archives of channels that the host is about to serve."""

from __future__ import annotations

from contextlib import suppress

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.archive.disk_use import ChannelDiskUse
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.objects.segment_store import StoreError
from stampede_rt_channel_host.archive.segment_files import OpenedArchive, SegmentFiles
from stampede_rt_channel_host.core.archive import ArchiveWindow, Segment, WantedItems, WantedWindow
from stampede_rt_channel_host.core.channel import FIRST_KEY
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY, ItemKey
from stampede_rt_channel_host.core.records import RecordedChannel

RESTORED_BYTES = 2**20


class OpenedChannelArchive:
    """The archive of a channel that the host is about to serve, and the newest items in it."""

    def __init__(
        self, files: SegmentFiles, found: OpenedArchive, newest: ArchiveWindow | None, disk: ChannelDiskUse
    ) -> None:
        self.files = files
        self.disk = disk
        self.found = found
        self.newest = newest


async def open_archive(
    archive: HostArchive, record: RecordedChannel, *, may_be_unknown: bool = False, is_move: bool = False
) -> OpenedChannelArchive:
    """Look at the archive of a channel. Raises Unavailable if the folder cannot be read or written.

    `may_be_unknown`: if the object store is unreachable, the host may serve the channel without its list of objects.
    `is_move`: another host still owns the channel, so what this host noted earlier does not count.
    """
    try:
        files, found = await archive.open(record, may_be_unknown=may_be_unknown, is_move=is_move)
        newest = await _newest(archive, files, found.segments)
    except OSError as error:
        raise Unavailable(
            f"the archive of channel {record.name} in {archive.place} cannot be used ({error.strerror}); free the "
            "disk, or give the host a folder that it can write, or an object store that it can reach, and open the "
            "channel again"
        ) from error
    return OpenedChannelArchive(files, found, newest, archive.disk.of_channel(record.channel_id, record.created_by))


async def _newest(archive: HostArchive, files: SegmentFiles, segments: tuple[Segment, ...]) -> ArchiveWindow | None:
    """The newest archived items; None: there are none. Raises OSError.

    While the object store is unreachable: the newest items on the disk, as far as they are later than all items in the
    store.
    """
    if not segments or not files.is_known:
        return None
    if files.is_listed:
        with suppress(StoreError):
            return await archive.load(files, segments, _latest_from(FIRST_KEY))
    stored = [one for one in segments if files.place.is_stored(one.number)]
    edge = max((one.high[0] for one in stored if one.high is not None), default=None)
    local = tuple(one for one in segments if one not in stored)
    window = await archive.load(files, local, _latest_from(FIRST_KEY if edge is None else (edge + 1, 0)))
    edges = [one for one in (edge, window.edge) if one is not None]
    return window._replace(edge=max(edges, default=None))


def _latest_from(low: ItemKey) -> WantedWindow:
    """The newest items, from the key `low` on."""
    wanted = WantedItems(low[0], LAST_KEY, 0, RESTORED_BYTES, down=True, bytes_limit=2**63)
    return WantedWindow(wanted, low, LAST_KEY, with_instants=True)
