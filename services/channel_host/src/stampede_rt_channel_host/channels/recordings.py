"""The recorded channels of a host."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from stampede_rt.errors import InvalidArgument, error_for
from stampede_rt.values.model import Policy
from stampede_rt.values.seq_starts import given_between, has_start
from stampede_rt.wire.run_slices import slice_run
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.opened_archives import OpenedChannelArchive, open_archive
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.core.channel.limits import check_policy_change
from stampede_rt_channel_host.core.dedup import KeptRun, RetryWindow
from stampede_rt_channel_host.core.records import RecordedChannel


class ArchiveCounts(NamedTuple):
    """The numbers of items that the archive will never have, of items that wait for it, and of damaged blocks."""

    unarchived: int
    backlog_items: int
    damaged_blocks: int


class Recordings:
    """Order of use for each channel: `prepare`, which may wait for the disk, and then `attach`.

    `archive` is None if the host has no archive.
    """

    def __init__(self) -> None:
        self.archive: HostArchive | None = None
        self.write_retries: Callable[[RetryWindow], bytes] = _nothing
        self.read_retries: Callable[[bytes], Iterable[KeptRun]] = lambda encoded: ()
        self._opened: dict[bytes, OpenedChannelArchive] = {}
        self._recorded: dict[bytes, Recording] = {}
        self._departed = ArchiveCounts(0, 0, 0)

    async def prepare(self, record: RecordedChannel, hosted: HostedChannel | None, *, is_move: bool = False) -> None:
        """Look at the archive of a channel that the host is about to serve as `record` says.

        If the object store is unreachable, a host that takes a channel over serves it without the store's items.

        Raises InvalidArgument if the channel is to be recorded and the host has no archive. Raises Unavailable if the
        archive cannot be used.
        """
        self.check(record.name, is_recorded=record.policy.is_recorded)
        is_same = hosted is not None and hosted.record.incarnation == record.incarnation
        if self.archive is None or not record.policy.is_recorded or (is_same and hosted and hosted.recording):
            return
        if record.channel_id in self._opened:  # a move has opened it
            return
        if hosted is not None and hosted.recording is not None:
            hosted.recording.stop()
        may_be_unknown = record.may_have_lost and has_start(record.epoch) and not is_move
        opened = await open_archive(self.archive, record, may_be_unknown=may_be_unknown, is_move=is_move)
        self._opened[record.channel_id] = opened

    def check_move(self, record: RecordedChannel) -> None:
        """Raises InvalidArgument if a recorded channel is to move here, and this host has no archive."""
        if record.policy.is_recorded and self.archive is None:
            raise InvalidArgument(
                f"channel {record.name} is recorded (archive), and this host has no archive; move it to a host that "
                "has one, or start this host with an archive (--archive FOLDER, or archive=... of st.host)",
                metadata={"channel": record.name},
            )

    async def prepare_move(self, record: RecordedChannel, next_seq: int) -> None:
        """Open the archive of a channel that is about to move here, before its changes are held.

        `next_seq`: the next seq of the channel. Raises the errors of `prepare`, and InvalidArgument if this host has
        items with these seqs in its archive, from another incarnation.
        """
        await self.prepare(record, None, is_move=True)
        opened = self._opened.get(record.channel_id)
        if opened is not None and any(one.end_seq > next_seq for one in opened.found.segments):
            raise InvalidArgument(
                f"this host has an archive of an earlier incarnation of channel {record.name}, with later seqs; move "
                "the channel to another host",
                metadata={"channel": record.name},
            )

    def give_up(self, channel_id: bytes) -> None:
        """Close the archive that a failed move has opened. Idempotent."""
        opened = self._opened.pop(channel_id, None)
        if opened is not None and self.archive is not None:
            self.archive.give_up(opened.files)

    async def adopt(
        self,
        record: RecordedChannel,
        hosted: HostedChannel | None,
        adopt: Callable[[RecordedChannel], HostedChannel],
        version: Callable[[], object] = lambda: None,
    ) -> HostedChannel:
        """Serve a channel as `record` says, and record it if its policy says so. Raises the errors of `prepare`.

        Raises StaleBinding (NOT_HERE) if `version()` changes while the host looks at the archive: the lease may have
        ended meanwhile, and the channel may have another owner. See `confirmed_record`.
        """
        before = version()
        await self.prepare(record, hosted)
        if before != version():
            self.give_up(record.channel_id)
            raise error_for("NOT_HERE", f"channel {record.name} changed while its archive was opened; resolve it again")
        return self.attach(adopt(record))

    def check(self, name: str, *, is_recorded: bool) -> None:
        """Raises InvalidArgument if a channel is to be recorded and the host has no archive."""
        if is_recorded and self.archive is None:
            raise InvalidArgument(
                f"channel {name} is to be recorded (archive), and its host has no archive; start the host with an "
                "archive (--archive FOLDER, or archive=... of st.host), or open the channel under another name with "
                "`host`, at a host that has one"
            )

    def check_change(self, record: RecordedChannel, stated: Policy) -> None:
        """Raises InvalidArgument if the channel cannot have a policy with the values of `stated`.

        Raises Overloaded if the archive has no room for a channel that was not recorded before.
        """
        check_policy_change(record.policy, stated)
        self.check(record.name, is_recorded=stated.is_recorded)
        if stated.is_recorded and not record.policy.is_recorded:
            self._check_room(record)

    def _check_room(self, record: RecordedChannel) -> None:
        """Raises Overloaded if the archive has no items of this channel yet, and no room for it."""
        if self.archive is not None:
            disk = self.archive.disk.of_channel(record.channel_id, record.created_by)
            if not disk.bytes:
                disk.check()

    def attach(self, hosted: HostedChannel) -> HostedChannel:
        """Record the channel from now on, if `prepare` has opened its archive."""
        opened = self._opened.pop(hosted.record.channel_id, None)
        if opened is not None and self.archive is not None:
            has_moved = hosted.moving is not None  # the archive gets all items that came with the move
            opened.files.raise_epoch(hosted.record.epoch)  # the files were opened before the move was committed
            recording = Recording(
                self.archive, opened, hosted.channel, slice_run, hosted.archived, from_memory=has_moved
            )
            self._keep_retries(hosted, opened, recording)
            recording.is_settled = lambda: hosted.core.next_seq == hosted.channel.next_seq
            hosted.record_with(recording)
            self._drop_stopped()
            self._recorded[hosted.record.channel_id] = recording
        return hosted

    def _keep_retries(self, hosted: HostedChannel, opened: OpenedChannelArchive, recording: Recording) -> None:
        """Continue the retry window of the former process. When this process stops, it notes its own window."""
        stop, retries = opened.found.stop, hosted.puts.retries
        recording.recorder.encoded_retries = lambda: self.write_retries(retries)
        if stop is not None and stop.incarnation == hosted.record.incarnation:
            for run in self.read_retries(stop.retries):
                retries.adopt(run)

    def start(self) -> None:
        """Move closed files to the object store from now on, if there is one."""
        if self.archive is not None:
            self.archive.start()

    def own(self, epochs: Mapping[bytes, int]) -> None:
        """Note the channels that the host owns as of its registration, by their ids, with their epochs. It may never
        serve some of them.
        """
        if self.archive is not None and self.archive.objects is not None:
            self.archive.objects.mover.own(epochs)

    def deleted(self, record: RecordedChannel) -> None:
        """Delete the archive of a channel that was deleted in the directory, if an object store has the archive."""
        if self.archive is not None and record.policy.is_recorded:
            self.archive.delete(record.channel_id)

    def counts(self) -> ArchiveCounts:
        """The sums over all channels that were recorded since the host started."""
        self._drop_stopped()
        present = [_counts(one) for one in self._recorded.values()]
        return ArchiveCounts(*map(sum, zip(self._departed, *present, strict=True)))

    def _drop_stopped(self) -> None:
        """Keep only the counts of the channels that the host no longer records."""
        for channel_id, recording in [*self._recorded.items()]:
            if recording.is_stopped:
                counts = _counts(self._recorded.pop(channel_id))._replace(backlog_items=0)
                self._departed = ArchiveCounts(*map(sum, zip(self._departed, counts, strict=True)))

    @property
    def has_object_store(self) -> bool:
        """Whether the closed files of the archives move to an object store."""
        return self.archive is not None and self.archive.objects is not None

    async def finish(self, boot_incarnation: int, seconds_max: float) -> None:
        """Bring the archives to the object store, while no other host can own the channels. Without an object store it
        does nothing.

        Call it when the host refuses all requests. After `seconds_max` the work goes on, and `close` waits for it.
        `close` also handles the channels with items that readers do not see yet.
        """
        if self.archive is not None and self.archive.objects is not None:
            present = self._present()
            settled = [one for one in present if one.is_settled()]
            is_all = len(settled) == len(present)
            recorders = [one.recorder for one in settled]
            await self.archive.finish(recorders, boot_incarnation if is_all else 0, seconds_max)

    async def close(self, boot_incarnation: int = 0) -> None:
        """Write the remaining items of all channels, because the host stops. `boot_incarnation`: see
        `HostArchive.close`.
        """
        if self.archive is not None:
            await self.archive.close([one.recorder for one in self._present()], boot_incarnation)

    def _present(self) -> list[Recording]:
        return [one for one in self._recorded.values() if not one.is_stopped]


def _nothing(_: RetryWindow) -> bytes:
    return b""


def _counts(recording: Recording) -> ArchiveCounts:
    recorder = recording.recorder
    backlog_items = given_between(recorder.archived_to, recorder.archived_to + recorder.backlog_items)
    return ArchiveCounts(recorder.named, backlog_items, recorder.files.damaged_blocks)
