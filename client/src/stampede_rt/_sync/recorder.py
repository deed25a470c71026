# Generated from ../_async by tools/generate.py; do not edit.
"""Records channels to a file. A recording may begin with items from before its start that the channels still hold."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from types import TracebackType
from typing import TYPE_CHECKING

from stampede_rt._sync.channel_recording import ChannelRecording
from stampede_rt._sync.recording_sink import FLUSH_S, RecordingSink
from stampede_rt._sync.session import Session
from stampede_rt._sync.watch import Watch
from stampede_rt.errors import InvalidArgument, StampedeError, WatchRestart
from stampede_rt.files.entries import FACTS_TOPIC
from stampede_rt.files.reading import CLOCKS_NAME
from stampede_rt.files.summaries import SUMMARY_NAME, summary_fields
from stampede_rt.files.writing import FileWriter
from stampede_rt.handles import BoundToProcess
from stampede_rt.transports.concurrency_sync import BackgroundStart, BackgroundTask, Signal, run_concurrently
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.values.recording import RecordingSummary
from stampede_rt.values.timeline import Bound
from stampede_rt.version import VERSION

if TYPE_CHECKING:
    from stampede_rt._sync.discovery import Discovery

CHANNELS_MAX = 1000  # the most channels of one recording; each may keep 1 MiB in memory
GLOBS_MAX = 64
DRAIN_S = 5.0  # the wait at the end of a recording for items that the host accepted before the end
BEGIN_S = 7.0  # together with DRAIN_S this is longer than a call takes, so the recording learns why a call failed
HURRIED_S = 0.1  # the least time that a step of the end may wait, if the time of `hurry` has passed
FINISHED_IN_PARALLEL = 32  # the channels whose recordings end in parallel
_log = logging.getLogger("stampede_rt")


class Recorder(BackgroundStart, BoundToProcess):
    """Records channels to a file, until `stop` (see `Connection.record`). A context manager.

    `summary` is None until the file is finished. `error` is the error that ended the recording, such as a full disk;
    the file then has everything written before.
    """

    def __init__(
        self,
        session: Session,
        discovery: Discovery,
        globs: Sequence[str],
        writer: FileWriter,
        begin: Bound | None,
        for_s: float | None,
    ) -> None:
        self._session = session
        self._discovery = discovery
        self._globs = tuple(globs)
        self._sink = RecordingSink(writer)
        self._begin_at = begin
        self._for_s = for_s
        self._drain_s = DRAIN_S
        self._until_s: float | None = None  # after `hurry`: when the recording of all channels should have ended
        self._channels: dict[bytes, ChannelRecording] = {}
        self._matched: set[str] = set()
        self._absent: list[str] = []
        self._watches: list[Watch] = []
        self._ending = False
        self._stop = Signal()
        self._has_begun = Signal()  # is set when the recording of all present channels has begun, or when it has ended
        self._ended = Signal()
        self.active = True
        self.summary: RecordingSummary | None = None
        self.error: StampedeError | None = None
        session.attach(self)
        self._background = BackgroundTask(self._run, f"recording of {', '.join(self._globs)}")

    def __repr__(self) -> str:
        state = self._session.state or ("" if self.active else "ended")
        return f"<Recorder of {', '.join(self._globs)}{f', {state}' if state else ''}>"

    def __enter__(self) -> Recorder:
        self._wait_for_start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._ended.wait(None)
        if kind is None and self.error is not None:
            raise self.error

    @property
    def channels(self) -> list[str]:
        """The names of the channels that are recorded, sorted."""
        return sorted({one.name for one in self._channels.values()})

    @property
    def recorded(self) -> int:
        """The number of items that are in the file so far."""
        return sum(tally.recorded for one in self._channels.values() for tally in one.tallies)

    def stop(self) -> None:
        """End the recording with the items that the hosts have accepted until now. Does not wait; see `wait`.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._session.check_thread()
        self._stop.set()

    def hurry(self, drain_s: float) -> None:
        """Stop, and wait for hosts and for outstanding items for at most `drain_s` seconds each.

        The summary names the missing items.
        """
        self._drain_s, self._until_s = drain_s, time.monotonic() + drain_s
        self.stop()

    def wait(self, timeout: float | None = None) -> RecordingSummary | None:
        """Wait until the file is finished, and return its summary; None after `timeout` seconds.

        None as `timeout` waits without a limit. Raises `error` if there is one.
        """
        self._session.check_process()
        if not self._ended.wait(timeout):
            return None
        if self.error is not None:
            raise self.error
        return self.summary

    def end(self) -> None:
        """Stop, and wait a moment for the file. The connection calls this when it closes."""
        self.hurry(1.0)
        self._ended.wait(3.0)

    def _wait_for_start(self) -> None:
        self._has_begun.wait(None)
        if self.error is not None:
            raise self.error

    def _run(self) -> None:
        try:
            self._begin()
            self._has_begun.set()
            self._pause()
            self._finish()
        except StampedeError as error:
            self.error = error
        except Exception as defect:  # noqa: BLE001  # otherwise nobody would learn of the defect
            self.error = StampedeError(f"the recording failed with a defect: {type(defect).__name__}: {defect}")
            self.error.__cause__ = defect
        finally:
            self._end_watches()
            self._sink.writer.abandon()
            self.active = False
            self._has_begun.set()
            self._ended.set()
            self._session.detach(self)

    def _begin(self) -> None:
        self._write_clocks("begin", BEGIN_S)
        for glob in self._globs:
            watch = self._watch(glob, later=False)
            BackgroundTask(partial(self._follow, glob, watch), f"watch for the recording of {glob!r}")
        for one in list(self._channels.values()):
            one.started.wait(BEGIN_S)
        if self._sink.error is not None:
            raise self._sink.error

    def _watch(self, glob: str, *, later: bool) -> Watch:
        """Watch for channels, and record the existing ones."""
        watch = Watch(self._session, glob, None)
        self._watches.append(watch)
        watch.__enter__()
        for info in self._discovery.channels(glob):
            self._record(glob, info, later=later)
        return watch

    def _follow(self, glob: str, watch: Watch) -> None:
        while not self._stop_requested():
            try:
                for change in watch:
                    if change.kind == "added" and isinstance(change.subject, ChannelInfo):
                        self._record(glob, change.subject, later=True)
                return
            except WatchRestart:
                watch = self._watch(glob, later=True)
            except StampedeError as error:
                if not self._stop_requested():
                    self._absent.append(f"channels {glob!r} that appeared later: {error.message}")
                return

    def _stop_requested(self) -> bool:
        return not self.active or self._session.closed or self._ending

    def _record(self, glob: str, info: ChannelInfo, *, later: bool) -> None:
        self._matched.add(glob)
        if info.channel_id in self._channels or self._ending:
            return
        if info.name == FACTS_TOPIC:
            problem = f"channel {info.name!r}: recordings need this name for themselves"
        elif len(self._channels) >= CHANNELS_MAX:
            problem = f"channel {info.name!r}: a recording has at most {CHANNELS_MAX} channels"
        else:
            state = self._session.state_of(info, Policy(), False)
            self._channels[info.channel_id] = ChannelRecording(
                self._session, state, self._sink, self._begin_at, later=later
            )
            return
        if len(self._absent) < CHANNELS_MAX:
            self._absent.append(problem)

    def _pause(self) -> None:
        """Wait for the end of the recording. Meanwhile ends chunks that have waited for FLUSH_S."""
        until_s = None if self._for_s is None else time.monotonic() + self._for_s
        while not self._sink.error:
            left_s = FLUSH_S if until_s is None else min(FLUSH_S, until_s - time.monotonic())
            if left_s <= 0 or self._stop.wait(left_s):
                return
            if self._sink.writer.pending:
                self._sink.do(self._sink.writer.flush)
        raise self._sink.error

    def _find_last(self) -> None:
        """Record the channels that appeared just before the end, and that no watch has reported yet."""
        found: list[tuple[str, ChannelInfo]] = []
        answered, problem = Signal(), "the directory did not answer in time"

        def look() -> None:
            nonlocal problem
            try:
                for glob in self._globs:
                    found.extend((glob, info) for info in self._discovery.channels(glob))
                problem = ""
            except StampedeError as error:
                problem = error.message
            finally:
                answered.set()

        BackgroundTask(look, "channels at the end of a recording")
        answered.wait(self._left_s())
        for glob, info in found:
            self._record(glob, info, later=True)
        if problem:
            self._absent.append(f"channels that appeared just before the end may be missing: {problem}")

    def _finish(self) -> None:
        self._find_last()
        self._ending = True
        self._end_watches()
        recordings = list(self._channels.values())
        for first in range(0, len(recordings), FINISHED_IN_PARALLEL):
            part = recordings[first : first + FINISHED_IN_PARALLEL]
            run_concurrently([partial(one.finish, self._left_s()) for one in part])
        self._write_clocks("end", self._left_s())
        summary = self._summary(recordings)
        self._sink.do(partial(self._sink.writer.add_metadata, SUMMARY_NAME, summary_fields(summary)))
        self._sink.do(self._sink.writer.finish)
        self.summary = summary

    def _left_s(self) -> float:
        """The time that the next step of the end may wait. After `hurry` all steps share about the time of one."""
        left_s = self._drain_s if self._until_s is None else self._until_s - time.monotonic()
        return min(self._drain_s, max(left_s, HURRIED_S))

    def _summary(self, recordings: Sequence[ChannelRecording]) -> RecordingSummary:
        absent = [f"no channel matches {glob!r}" for glob in self._globs if glob not in self._matched]
        absent += self._absent + [one.problem for one in recordings if one.problem]
        counts = [tally.counts() for one in recordings for tally in one.tallies]
        counts.sort(key=lambda one: one.channel)
        path = str(self._sink.writer.path)
        return RecordingSummary(path=path, channels=tuple(counts), absent=tuple(absent))

    def _end_watches(self) -> None:
        for watch in self._watches:
            watch.close()

    def _write_clocks(self, moment: str, timeout_s: float) -> None:
        """Write how far the clocks of all named peers are ahead, as they have measured it."""
        own = self._session.supernodes.clock
        values = {"version": "1", "moment": moment, "recorder": VERSION, "recorder_time": str(time.time_ns())}
        if own is not None:
            values["recorder_clock"] = json.dumps(asdict(own))
        values |= self._clocks_of_peers(timeout_s)
        self._sink.do(partial(self._sink.writer.add_metadata, CLOCKS_NAME, values))

    def _clocks_of_peers(self, timeout_s: float) -> dict[str, str]:
        found: dict[str, str] = {}
        answered = Signal()

        def ask() -> None:
            try:
                peers = {one.name: asdict(one.clock) for one in self._discovery.peers() if one.clock is not None}
                found["peers"] = json.dumps(peers)
            except StampedeError as error:
                found["peers_missing"] = error.message
            finally:
                answered.set()

        BackgroundTask(ask, "clocks of the peers for a recording")
        if answered.wait(timeout_s):
            return found
        return {"peers_missing": f"the directory did not answer within {timeout_s:.1f} s"}


def parse_globs(channels: Sequence[object] | object) -> list[str]:
    """Return the names and globs of the argument `channels`. Raises InvalidArgument."""
    many = channels if isinstance(channels, Sequence) and not isinstance(channels, str) else [channels]
    globs = [one if isinstance(one, str) else str(getattr(one, "name", "")) for one in many]
    if not globs or not all(globs) or len(globs) > GLOBS_MAX:
        raise InvalidArgument(
            f"channels is {channels!r}; give 1 to {GLOBS_MAX} names, globs such as 'rig/*', or handles of channels"
        )
    return globs
