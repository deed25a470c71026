# Generated from ../_async by tools/generate.py; do not edit.
"""Records one channel: all its items from a moment on, over breaks and over losses of its host."""

from __future__ import annotations

import json
import time
from dataclasses import asdict

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.recording_sink import RecordingSink
from stampede_rt._sync.recording_stream import RecordedBatch, RecordingStream
from stampede_rt._sync.session import Session
from stampede_rt.errors import ChannelNotFound, FileError, IncarnationLost, StampedeError
from stampede_rt.files.entries import POLICY_KEY
from stampede_rt.files.tally import ChannelTally
from stampede_rt.transports.concurrency_sync import BackgroundTask, Signal
from stampede_rt.values.answers import Items
from stampede_rt.values.model import Item
from stampede_rt.values.recording import RecordingGap
from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import NOW, OLDEST, Bound, format_instant

LOOKS_MAX = 16  # the most gets that look for the end of the losses of a channel


class ChannelRecording:
    """Records one channel, in the background, from the making of this object until `finish`.

    `begin`: where the recording begins; None: with the next item; OLDEST: with the oldest held item. `later`: the
    channel appeared while the recording of other channels ran, so all its items belong to the recording.
    """

    def __init__(
        self, session: Session, state: ChannelState, sink: RecordingSink, begin: Bound | None, *, later: bool
    ) -> None:
        self.name = state.info.name
        self._session = session
        self._state = state
        self._channel = Channel(session, state)
        self._sink = sink
        self._begin = begin
        # Whether all items of the present incarnation belong to the recording, and it is the first one of the channel.
        self._from_first = later and state.info.epoch == 1
        self._info, self._is_new = state.info, later
        self._later = later or begin == OLDEST
        policy = {key: value for key, value in asdict(state.info.policy).items() if value is not None}
        self._metadata = ((POLICY_KEY, json.dumps(policy)),)
        self._stream: RecordingStream | None = None
        # The earliest item that the first read found; None after it is recorded or named as missing.
        self._first: Item | None = None
        # The earliest time that an item of the recording may have; None: the recording begins with the oldest item.
        self._begins: int | None = None if self._later else time.time_ns()
        # After the loss of the host: items of this time, up to this seq, come again from an archive.
        self._repeated: tuple[int | None, int] = (None, 0)
        self._end_seq: int | None = None
        self._ending = False
        self._done = Signal()
        self.started = Signal()  # is set when the recording of the channel has begun, or has failed
        self.tallies: list[ChannelTally] = []
        self.problem = ""  # why nothing of the channel could be recorded
        self._background = BackgroundTask(self._run, f"recording of channel {self.name!r}")

    def _run(self) -> None:
        try:
            self._record_all()
        except FileError:
            pass  # the sink keeps this error, and ends the whole recording
        except StampedeError as error:
            self._fail(error)
        except Exception as defect:  # noqa: BLE001  # otherwise nobody would learn of the defect
            self._fail(StampedeError(f"a defect: {type(defect).__name__}: {defect}"))
        finally:
            self.started.set()
            self._done.set()

    def _record_all(self) -> None:
        anew = self._later
        while not self._ending:
            try:
                self._record(anew)
            except IncarnationLost as error:
                self._note_unread_incarnation(error.message)
                read_to = 0 if self._stream is None else self._stream.read_to
                self._end_incarnation("LOST", error.message)
                anew, self._repeated, self._from_first = True, (self._recorded_to(), read_to), False

    def _note_unread_incarnation(self, detail: str) -> None:
        """Note that items of a new channel may have been lost with its host before the recording could read them."""
        if not self._from_first or self.tallies:
            return
        tally = ChannelTally(self.name, self._info.incarnation, 1)
        self.tallies.append(tally)
        gap = RecordingGap(channel=self.name, incarnation=tally.incarnation, reason="LOST", detail=detail, first_seq=1)
        self._sink.write(tally, RecordedBatch(gaps=[gap]), self._metadata)
        self._sink.end_channel(tally, 0, None)

    def _fail(self, error: StampedeError) -> None:
        """Note that the channel cannot be recorded any further."""
        if not self.tallies:
            self.problem = error.message
            return
        try:
            self._end_incarnation(reason_of(error), error.message)
        except FileError:
            return

    def _record(self, anew: bool) -> None:
        """Record one incarnation, until `finish` or an error."""
        looked: list[RecordingGap] = []
        start = self._start_anew() if anew else None
        if anew and not self.tallies:
            looked = self._look_at_oldest()
        elif self._begin is not None and not anew:
            start, looked = self._look(self._begin)
        name = f"the recording of channel {self.name!r}"
        from_first = self._from_first
        self._stream = stream = RecordingStream.of(
            self._session, self._state, start, name, held=True, from_first=from_first
        )
        stream.names_losses = bool(self.tallies) or any(gap.reason == "LOST" for gap in looked)
        stream.begin_reading()
        if stream.opened_seq is None:
            return
        if self._state.info.channel_id != self._info.channel_id:  # another recording follows the new channel
            stream.close()
            self._stream = None
            raise ChannelNotFound(f"channel {self.name} was deleted, and made again")
        tally = ChannelTally(self.name, stream.incarnation, 1 if from_first else stream.opened_seq)
        self.tallies.append(tally)
        self._sink.write(tally, RecordedBatch(gaps=looked), self._metadata)
        self.started.set()
        while (batch := stream.next_batch()) is not None:
            self._write(tally, batch, stream.read_to)
            if batch.next_live_seq is not None:
                tally = self._next_tally(tally, stream.incarnation, batch.next_live_seq)
            if self._end_seq is not None and stream.read_to >= self._end_seq:
                stream.close()

    def _recorded_to(self) -> int | None:
        """The greatest time of the recorded items; without items the time at which the recording began, if known."""
        times = [one.newest for one in self.tallies if one.newest is not None]
        return max(times, default=self._begins)

    def _start_anew(self) -> Bound:
        """Return where to begin if the host was lost.

        The archive of a recorded channel also has the items that the recording has already. So the recording of such a
        channel begins at its last recorded time, and not at the oldest item.
        """
        known = self._recorded_to() if self.tallies and self._state.info.policy.is_recorded else None
        return OLDEST if known is None else Bound(None, known)

    def _next_tally(self, tally: ChannelTally, incarnation: int, live_seq: int) -> ChannelTally:
        """End the tally of a lost owner. The next one has the items that a replica accepts from `live_seq` on."""
        self._sink.end_channel(tally, None, None)
        self.tallies.append(ChannelTally(self.name, incarnation, live_seq))
        return self.tallies[-1]

    def _look(self, begin: Bound) -> tuple[Bound, list[RecordingGap]]:
        """Return the instant at which the recording begins, and a gap if the channel lacks items since this instant."""
        found = self._found_from(begin)
        if found.interval is None:
            return OLDEST, []
        self._first = found[0] if found else None
        begins = self._begins = found.interval.start
        if found.reason == "LOST":
            return Bound(None, begins), [self._lost_gap(found)]
        if not found.truncated:
            return Bound(None, begins), []
        ends = found[0].time if found else None
        gap = RecordingGap(
            channel=self.name, incarnation=found.incarnation, reason="COLLECTED", start=begins, end=ends,
            detail=_collected_text(begins, ends),
        )  # fmt: skip
        return Bound(None, begins), [gap]

    def _look_at_oldest(self) -> list[RecordingGap]:
        """Return a gap if a former host of the channel was lost with items. Only an archive knows such a loss."""
        found = self._found_from(OLDEST)
        if found.reason == "LOST":
            return [self._lost_gap(found)]
        if not self._is_new or self._from_first or self.tallies:
            return []
        if (self._channel.stats()).has_lost_items is False:  # the channel has only moved
            self._from_first = True
            return []
        detail = "the channel had another host before the recording could read it; its items may have been lost"
        return [RecordingGap(channel=self.name, incarnation=found.incarnation, reason="LOST", detail=detail)]

    def _found_from(self, start: Bound, *, newest_first: bool = False) -> Items:
        return self._channel.get(
            start, NOW, match="start", limit=1, newest_first=newest_first, payloads=False, timeout=0
        )

    def _lost_gap(self, found: Items) -> RecordingGap:
        """Return the gap for all losses in the interval of an answer with the reason LOST.

        The gap ends at the latest loss. It begins with the interval, because such an answer does not name each loss.
        """
        within, incarnation, details = found.interval, found.incarnation, []
        bounds = {} if within is None else {"start": within.start, "end": within.end}
        for _ in range(LOOKS_MAX):
            if within is None or found.reason is None:
                break
            details.append(found.reason.detail)
            before = found.reason.before
            if before is None or before > within.end:
                break
            found = self._found_from(Bound(None, before))
            if found.reason != "LOST" and not found.truncated:
                bounds["end"] = before - 1
                break
        detail = "; ".join(dict.fromkeys(details))
        return RecordingGap(channel=self.name, incarnation=incarnation, reason="LOST", detail=detail, **bounds)

    def _write(self, tally: ChannelTally, batch: RecordedBatch, read_to: int) -> None:
        repeated_time, repeated_to = self._repeated
        if repeated_time is not None and batch.items:
            batch.items = [one for one in batch.items if one.time != repeated_time or one.seq > repeated_to]
            self._repeated = (repeated_time if read_to < repeated_to else None, repeated_to)
        first, gaps = self._first, list(batch.gaps)
        if first is not None and (read_to >= first.seq or batch.items):
            self._first = None
            is_reported = any(item.seq == first.seq for item in batch.items) or any(
                (gap.first_seq or 0) <= first.seq <= (gap.last_seq or 0) for gap in gaps
            )
            if not is_reported and first.incarnation == tally.incarnation:
                self._first = first if batch.items and batch.items[-1].seq < first.seq else None
                gaps += [] if self._first else [self._edge_gap(first)]
        batch.gaps = gaps
        self._sink.write(tally, batch, self._metadata)

    def _edge_gap(self, first: Item) -> RecordingGap:
        return RecordingGap(
            channel=self.name, incarnation=first.incarnation, reason="COLLECTED", start=first.time,
            detail="the channel collected its oldest items while the recording began",
        )  # fmt: skip

    def _end_incarnation(self, reason: str, detail: str) -> None:
        """Note that an unknown number of items after the last read item is missing."""
        if not self.tallies or self._stream is None or self._stream.opened_seq is None:
            return
        tally = self.tallies[-1]
        read_to = self._stream.read_to
        end = None if reason == "UNAVAILABLE" else self._stream.latest_time()
        gap = RecordingGap(
            channel=self.name, incarnation=tally.incarnation, reason=reason, detail=detail, first_seq=read_to + 1,
            end=end,
        )  # fmt: skip
        self._sink.write(tally, RecordedBatch(gaps=[gap]), self._metadata)
        self._sink.end_channel(tally, read_to, None)
        self._stream = None

    def finish(self, drain_s: float) -> None:
        """Record the items that the host has accepted until now, and end.

        Each step waits at most `drain_s` seconds: for the last seq that the host has accepted, and for the items.
        """
        self.started.wait(drain_s)
        accepted, advance, unknown = self._accepted(drain_s)
        self._ending, stream = True, self._stream
        if stream is None or stream.opened_seq is None:
            self._give_up(stream)
            return
        end_seq = self._end_seq = stream.read_to if accepted is None else accepted
        if stream.read_to >= end_seq or not self._done.wait(drain_s):
            stream.close()
        self._done.wait(drain_s)
        if self._stream is not stream:  # the stream was lost meanwhile
            return
        if unknown is not None:
            self._end_incarnation(*unknown)
        else:
            self._sink.end_channel(self.tallies[-1], end_seq, advance)

    def _give_up(self, stream: RecordingStream | None) -> None:
        if stream is not None:
            stream.close()
        if not self.tallies:
            self.problem = self.problem or f"channel {self.name!r}: its host, or its archive, did not answer in time"

    def _accepted(self, timeout_s: float) -> tuple[int | None, int | None, tuple[str, str] | None]:
        """Return the last seq that the host has accepted, and the channel's advance; None if they cannot be known.

        The third value is the reason and the detail of the gap at the end, if the last seq cannot be known.
        """
        try:
            stats = self._channel._stats_within(timeout_s)
            if self.tallies and stats.incarnation != self.tallies[-1].incarnation:
                return None, None, ("LOST", f"channel {self.name!r} has begun anew: its host was lost with its items")
            last = stats.accepted if stats.next_seq is None else self._last_seq(stats.next_seq)
        except StampedeError as error:
            return None, None, (reason_of(error), error.message)
        return last, stats.advance, None

    def _last_seq(self, next_seq: int) -> int:
        """Return the seq of the last item before `next_seq`. Raises StampedeError if it cannot be known.

        An owner that follows a lost owner leaves out many seqs. Until it accepts its first item, the last item is not
        at `next_seq - 1`. So this reads the newest item of the channel.
        """
        if next_seq == 1 or given_between(1, next_seq):
            return next_seq - 1
        found = self._found_from(OLDEST, newest_first=True)
        return found[0].seq if found else 0


def reason_of(error: StampedeError) -> str:
    """Return the reason of the gap after the last item that the recording could read before `error`."""
    return "DELETED" if isinstance(error, ChannelNotFound) else "UNAVAILABLE"


def _collected_text(begins: int, oldest: int | None) -> str:
    """The text of the gap of a channel that lacks items since the instant `begins`. `oldest`: its oldest time."""
    until = "" if oldest is None else f"; its oldest item is of {format_instant(oldest)}"
    return (
        f"the channel no longer held all items since {format_instant(begins)}{until}; give it a longer max_age, or "
        "record less of the past"
    )
