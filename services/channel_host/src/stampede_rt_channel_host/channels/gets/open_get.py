"""One get under way at a host."""

from __future__ import annotations

from stampede_rt.errors import AheadOfClock, InvalidArgument
from stampede_rt.values.timeline import format_instant
from stampede_rt_channel_host.channels import copied_archives
from stampede_rt_channel_host.channels.gets.get_plans import GetPlan
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.past_reads import PastSummary
from stampede_rt_channel_host.core.channel import PendingGet, ReadAnswer, UnfinishedWork, WakeAt, first_of


class OpenGet:
    """One get of a channel, from its start to its answer."""

    __slots__ = (
        "_begun_at",
        "_polled_at",
        "call_id",
        "continues",
        "hosted",
        "past",
        "pending",
        "plan",
        "waits_for_archive",
    )

    def __init__(self, call_id: int, plan: GetPlan, hosted: HostedChannel, now: int) -> None:
        self.call_id = call_id
        self.plan = plan
        self.hosted = hosted
        self.pending: PendingGet | None = None  # the query and interval of a blocking get; None for other gets
        self.continues = False  # whether the answer was cut off for its length
        self.waits_for_archive = False  # whether the archive must complete the answer from memory
        self.past: PastSummary | None = None  # set for a get as of an earlier instant
        self._begun_at = now
        self._polled_at: int | None = None  # `hosted.changes` at the last poll; None: no poll, or an outdated one

    def reads_archive(self, now: int) -> bool:
        """Whether the answer may have items that only the archive of the channel has, or is as of an earlier instant.

        Raises InvalidArgument for a get that cannot be answered as of an earlier instant, and StaleBinding (MOVED) if
        only the owner has the archive.
        """
        if self.plan.as_of is not None:
            self._check_past(self.plan.as_of, now)
            return True
        recording = self.hosted.recording
        if self.plan.within_memory:
            return False
        if recording is None:
            copied_archives.check_read(self.hosted, self.plan.query, now)
        return recording is not None and recording.reaches(self.plan.query, now)

    def _check_past(self, as_of: int, now: int) -> None:
        name = self.hosted.record.name
        if copied_archives.lacks_archive(self.hosted):
            raise copied_archives.refusal(self.hosted)
        if self.hosted.recording is None:
            why = f"channel {name} is not recorded, so its host does not know its past; record it (archive)"
        elif self.plan.wait_nanos:
            why = f"the read of channel {name} has a time to wait, and a read as of an instant cannot wait"
        elif as_of > now:
            text = f"{format_instant(as_of)} is ahead of the host's clock, {format_instant(now)}"
            metadata = {"channel": name, "host_time_unix_nano": str(now)}
            raise AheadOfClock(f"as_of: {text}; read as of a past instant", metadata=metadata)
        else:
            return
        raise InvalidArgument(f"as_of: {why}")

    def poll(self, now: int) -> ReadAnswer | WakeAt | UnfinishedWork[ReadAnswer | WakeAt]:
        """Look for the answer of a blocking get.

        Returns the answer, or when to look again, or, if the work is long, the rest of the work.
        """
        assert self.pending is not None, "only a blocking get is polled"
        self._polled_at = self.hosted.changes
        return first_of(self.hosted.channel.polling(self.pending, now))

    def released(self) -> None:
        """Note that the get no longer waits, perhaps because of an earlier state of the channel. Sets `is_outdated`."""
        self._polled_at = None

    @property
    def is_outdated(self) -> bool:
        """Whether the channel has changed since the last poll, so that the result of that poll may be out of date."""
        return self._polled_at != self.hosted.changes

    def wait_nanos(self, now: int) -> int:
        """The time in nanoseconds that the get may still wait; below 0: without limit."""
        wait_nanos = self.plan.wait_nanos
        return wait_nanos if wait_nanos < 0 else max(0, self._begun_at + wait_nanos - now)
