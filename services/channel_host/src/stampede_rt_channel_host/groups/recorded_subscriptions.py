"""Subscriptions of recorded channels through a group: items that have left memory come from the archive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from stampede_rt.values.timeline import Bound, Interval
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import Query, SubscriptionBatch
from stampede_rt_channel_host.core.group import Horizon, RecordedStep, VisibleAllCursor

LATE_BYTES = 2**20
"""One step searches about this number of bytes of the archive for late items."""


class RecordedSteps:
    """Takes those steps of one subscription whose items have left memory."""

    def __init__(self, channels: ChannelStore, place: VisibleAllCursor) -> None:
        """`place`: the position of the reader."""
        self._channels, self._place = channels, place
        self._step: RecordedStep | None = None

    @property
    def under_way(self) -> bool:
        """Whether a step has begun, and has not brought all its items yet."""
        return self._step is not None

    async def take(self, recording: Recording, horizon: Horizon, limit_bytes: int) -> SubscriptionBatch | None:
        """The next part, or None if memory has the next step. Raises Unavailable if the archive cannot be read."""
        now = self._channels.now()
        step = self._step = self._step or self._place.unheld_step(horizon, now)
        if step is None:
            return None
        batch = step.batch(limit_bytes)
        if batch.is_empty and not step.is_over:
            await self._read(recording, step)
            batch = step.batch(limit_bytes)
        if not step.is_over:
            return replace(batch, more=True)
        if not batch.is_empty:
            return batch
        self._step = None
        self._place.skip_to(step, self._channels.now())
        return SubscriptionBatch(gap=step.gap, more=True)

    async def _read(self, recording: Recording, step: RecordedStep) -> None:
        if step.late is not None:
            found = await recording.items_from(step.late, LATE_BYTES, self._channels.now)
            step.take_late(*found, recording.kept_from)
            return
        view = await recording.read_in_group(
            step.query, _at(step.target), None, self._channels.scheduler, self._channels.now, waits=False
        )
        step.take_page(
            view.answer, continues=view.continues, missing_items=view.missing_items, kept_from=recording.kept_from
        )


async def resolved_start(
    hosted: HostedChannel, channels: ChannelStore, horizon: Callable[[], Horizon], start: Bound
) -> Bound:
    """The bound at which a subscription begins, over the archive and memory. Raises Unavailable as `take`.

    If the group shows no item of the channel yet, `start` may have no instant. The group may show one while this
    function waits for the archive. So the function looks again until `horizon` has not changed meanwhile.
    """
    recording = hosted.recording
    while recording is not None:
        seen = horizon()
        recording.check_start(start, channels.now(), seen)
        query = Query(interval=Interval(start, start), limit=1)
        expected = recording.recorder.former.are_expected
        if not recording.may_read or (expected and not recording.reaches_in_group(query, seen, channels.now())):
            return start  # it needs no archived item
        view = await recording.read_in_group(query, seen, None, channels.scheduler, channels.now, waits=False)
        if view.within is not None:
            return Bound(None, view.within.start)
        if horizon().cut == seen.cut:
            return start
    return start


def _at(cut: int) -> Horizon:
    return Horizon(cut, lambda: "by the step of the subscription")
