"""Sends a put to the replicas of its channel before the host stores it, so that the replicas work meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.puts import ChannelPuts
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.core.channel import ABSENT, Body, ChannelCore, NewItem, PutOutcome


class ReplicatedPuts:
    """Puts runs into a channel. Sends a run to the feeds as soon as the channel has accepted all its items.

    After the judgement only a defect can keep the channel from storing the run. Then the feeds end, and the replicas
    begin anew.
    """

    def __init__(self, core: ChannelCore, replication: Replication) -> None:
        self._core = core
        self._replication = replication

    def store(self, run: IncomingRun, now: int) -> PutOutcome:
        """Judge and store the rest of a run."""
        if run.progress.judged_items or not run.producer_id or not self._replication.is_filled:
            return self._core.put(run.offer, now, run.seal)
        try:
            return self._core.put(run.offer, now, partial(self._seal, run, now))
        except BaseException:
            self._replication.take_back()
            raise

    def _seal(
        self, run: IncomingRun, now: int, first_seq: int, kept: Sequence[int] | None, stamped_time: int | None
    ) -> Body:
        body, offer = run.seal(first_seq, kept, stamped_time), run.offer
        if first_seq != self._core.next_seq or kept is not None:  # stored already, or only a part is accepted
            return body
        time = stamped_time if offer.times is None else offer.span.low
        assert time is not None, "the channel gives a time to items without one"
        duration = ABSENT if offer.durations is None or run.items > 1 else offer.durations[0]
        item = NewItem(
            first_seq, run.producer_id, run.first_number, time, duration, sum(offer.lengths), stamped_time is not None,
            now, body, run.caller_name, run.items,
        )  # fmt: skip
        self._replication.send_ahead(item)
        return body


def send_ahead(puts: ChannelPuts, core: ChannelCore, replication: Replication) -> None:
    """From now on, send each put of a channel to its replicas before the host stores it.

    Refuse puts while the replicas are far behind.
    """
    puts.check_room, puts.store = replication.check_room, ReplicatedPuts(core, replication).store
