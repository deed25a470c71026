"""The archive of a channel in its protobuf form."""

from __future__ import annotations

from stampede_rt.v1 import channel_pb2
from stampede_rt_channel_host.archive.disk_use import FOLDER_BYTES
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.core.channel import Pieces

SEGMENTS_PER_PIECE = 2048


def archive_status(recorder: ChannelRecorder, archive: HostArchive) -> Pieces[channel_pb2.ArchiveStatus]:
    """The status of the archive as of the first piece of work: an archive may have many files."""
    status = channel_pb2.ArchiveStatus(
        disk_bytes=max(0, recorder.disk.bytes - FOLDER_BYTES),
        oldest_unix_nano=recorder.span.oldest,
        newest_unix_nano=recorder.span.newest,
        waiting=recorder.waiting_items,
        unarchived=recorder.unarchived,
        place=archive.place,
        failure=recorder.failure or archive.store_failure,
    )
    segments = recorder.segments
    for begin in range(0, len(segments), SEGMENTS_PER_PIECE):
        piece = segments[begin : begin + SEGMENTS_PER_PIECE]
        status.items += sum(one.items for one in piece)
        status.bytes += sum(one.length for one in piece)
        yield
    return status
