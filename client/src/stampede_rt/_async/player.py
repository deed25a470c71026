"""Puts the items of a file into channels: at the pace at which they came, or as fast as possible."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from types import TracebackType

from stampede_rt._async.played_channel import PlayedChannel
from stampede_rt._async.session import Session
from stampede_rt.errors import FileError, InvalidArgument, StampedeError
from stampede_rt.files.chunk_content import Event
from stampede_rt.files.entries import FileAdvance, FileEntry
from stampede_rt.files.file_source import FileSource, SourceTopic, none_chosen
from stampede_rt.files.names import channel_name
from stampede_rt.files.schedule import Schedule, target_policy, window_text
from stampede_rt.handles import BoundToProcess
from stampede_rt.transports.concurrency_async import BackgroundStart, BackgroundTask, Signal, in_thread
from stampede_rt.values.recording import GAPS_KEPT_MAX, RecordingGap, ReplaySummary
from stampede_rt.values.timeline import MAX_INSTANT

EVENTS_PER_STEP = 64  # the events that one step reads from the file


@dataclass(frozen=True, kw_only=True, slots=True)
class PlayRequest:
    """The part of the file to play, and the way to play it.

    `start` and `end` are times of the file, `end` exclusive. `speed` 0: without pauses.
    """

    prefix: str
    chosen: Callable[[str], bool]
    speed: float
    start: int
    end: int
    loop: bool
    shift: int | str | None


class Player(BackgroundStart, BoundToProcess):
    """Plays a file into channels, until the end of the file or `stop` (see `Connection.replay_file`).

    A context manager. `summary` is None until the replay has ended. `error` is the error that ended it early.
    """

    def __init__(self, session: Session, source: FileSource, request: PlayRequest) -> None:
        self._session = session
        self._source = source
        self._request = request
        self._channels: dict[str, PlayedChannel] = {}
        self._gaps: list[RecordingGap] = []
        self._rounds = 0
        self._done_share = 0.0
        self._stop = Signal()
        self._stopped = False
        self._holds = Signal()  # is set when the channels are open and take the items, or when the replay has ended
        self._ended = Signal()
        self.active = True
        self.summary: ReplaySummary | None = None
        self.error: StampedeError | None = None
        session.attach(self)
        self._background = BackgroundTask(self._run, f"replay of {source.path}")

    def __repr__(self) -> str:
        state = self._session.state or ("" if self.active else "ended")
        return f"<Player of {self._source.path!r}{f', {state}' if state else ''}>"

    async def __aenter__(self) -> Player:
        await self._wait_for_start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        await self._ended.wait(None)
        if kind is None and self.error is not None:
            raise self.error

    @property
    def channels(self) -> list[str]:
        """The names of the channels that get items, sorted."""
        return sorted(one.name for one in self._channels.values())

    @property
    def accepted(self) -> int:
        """The number of items that the channels have accepted so far."""
        return sum(one.accepted for one in self._channels.values())

    @property
    def done_share(self) -> float:
        """The part of the file's time span that this round has played, from 0 to 1."""
        return self._done_share

    def stop(self) -> None:
        """End the replay after the present item. Does not wait; see `wait`.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._session.check_thread()
        self._stopped = True
        self._stop.set()

    async def wait(self, timeout: float | None = None) -> ReplaySummary | None:
        """Wait until the replay has ended, and return its summary; None after `timeout` seconds.

        None as `timeout` waits without a limit. Raises `error` if there is one.
        """
        self._session.check_process()
        if not await self._ended.wait(timeout):
            return None
        if self.error is not None:
            raise self.error
        return self.summary

    async def end(self) -> None:
        """Stop, and wait a moment. The connection calls this when it closes."""
        self.stop()
        await self._ended.wait(1.0)

    async def _wait_for_start(self) -> None:
        await self._holds.wait(None)
        if self.error is not None:
            raise self.error

    async def _run(self) -> None:
        try:
            await self._play_all()
        except StampedeError as error:
            self.error = error
        except Exception as defect:  # noqa: BLE001  # otherwise nobody would learn of the defect
            self.error = StampedeError(f"the replay failed with a defect: {type(defect).__name__}: {defect}")
            self.error.__cause__ = defect
        finally:
            self._source.close()
            self.active = False
            self._holds.set()
            self._ended.set()
            self._session.detach(self)

    async def _play_all(self) -> None:
        topics = await in_thread(partial(self._source.topics, self._request.chosen))
        if not topics:
            raise InvalidArgument(await in_thread(partial(none_chosen, self._source)))
        schedule = self._plan(topics, time.time_ns())
        await self._open(topics, schedule)
        self._holds.set()
        try:
            await self._play_rounds(topics, schedule)
        except FileError as error:  # the file is damaged after the items so far
            await self._flush()
            raise FileError(f"{error.message}; the channels had accepted {self.accepted} items before") from error
        finally:
            for one in self._channels.values():
                await one.aclose()
        self.summary = self._summarize(await self._collected())

    async def _play_rounds(self, topics: Sequence[SourceTopic], schedule: Schedule) -> None:
        while not self._stopped:
            await self._play_round(schedule)
            self._rounds += not self._stopped
            if not self._request.loop:
                break
            # not before the former round has ended, also if the clock was set back a little
            schedule = self._plan(topics, max(time.time_ns(), schedule.shifted(schedule.end)))
        await self._flush()

    def _plan(self, topics: Sequence[SourceTopic], now: int) -> Schedule:
        start = max(self._request.start, min(one.start for one in topics))
        end = max(self._last_time(one) for one in topics)
        return Schedule.plan(start, max(start, end), self._request.speed, self._request.shift, now)

    def _last_time(self, topic: SourceTopic) -> int:
        """The last time of a topic that is played. Files of other programs may have times after MAX_INSTANT."""
        return topic.end if self._request.end == MAX_INSTANT else min(topic.end, self._request.end - 1)

    async def _open(self, topics: Sequence[SourceTopic], schedule: Schedule) -> None:
        """Open a channel for each topic with items to put, and check that none of them would refuse the items.

        Raises InvalidArgument, also if there are no items to put. If an existing channel would refuse items, this
        method creates no channel.
        """
        start, end = self._request.start, self._request.end
        firsts = {one.name: await in_thread(partial(self._source.first_time, one.name, start, end)) for one in topics}
        topics = [one for one in topics if firsts[one.name] is not None]
        if not topics:
            when = window_text(self._request.start, self._request.end)
            raise InvalidArgument(f"the file {self._source.path!r} has no items of the chosen topics{when}")
        targets = self._targets(topics)
        missing: list[tuple[str, SourceTopic]] = []
        for name, topic in targets:
            if (channel := await PlayedChannel.open(self._session, name)) is None:
                missing.append((name, topic))
            else:
                await self._add(topic, channel, firsts[topic.name], schedule)
        for name, topic in missing:
            await self._add(topic, await self._create(name, topic, schedule), firsts[topic.name], schedule)

    async def _create(self, name: str, topic: SourceTopic, schedule: Schedule) -> PlayedChannel:
        """Create a channel with its recorded policy, without its archive if no host has one."""
        request = self._request
        shifted, lag = request.shift is not None, schedule.lag_nanos
        policy = partial(target_policy, topic.policy, shifted, lag, keeps_all=request.speed == 0)
        try:
            return await PlayedChannel.create(self._session, name, policy(archived=True))
        except InvalidArgument:
            return await PlayedChannel.create(self._session, name, policy(archived=False))

    async def _add(self, topic: SourceTopic, channel: PlayedChannel, first: int | None, schedule: Schedule) -> None:
        """Play a topic into a channel, unless the channel would refuse items. Raises InvalidArgument."""
        self._channels[topic.name] = channel
        first = topic.start if first is None else first
        await channel.check(first, max(first, self._last_time(topic)), schedule)

    def _targets(self, topics: Sequence[SourceTopic]) -> list[tuple[str, SourceTopic]]:
        """The names of the channels for the topics. Raises InvalidArgument if two topics would become one channel."""
        taken: dict[str, SourceTopic] = {}
        for topic in topics:
            name = channel_name(topic.name, self._request.prefix)
            if (other := taken.setdefault(name, topic)) is not topic:
                raise InvalidArgument(
                    f"the topics {other.name!r} and {topic.name!r} would both become channel {name!r}; choose one"
                )
        return [*taken.items()]

    async def _play_round(self, schedule: Schedule) -> None:
        request, began = self._request, time.monotonic_ns()
        events = self._source.events(request.chosen, request.start, request.end)
        while part := await in_thread(partial(_some, events)):
            for due, event in part:
                wait = (schedule.due_nanos(due) - (time.monotonic_ns() - began)) / 1e9
                if (wait > 0 and await self._stop.wait(wait)) or self._stopped:
                    return
                self._done_share = (due - schedule.start) / max(1, schedule.end - schedule.start)
                await self._take(event, schedule)
        await self._stop.wait(max(0.0, (schedule.due_nanos(schedule.end) - (time.monotonic_ns() - began)) / 1e9))

    async def _take(self, event: Event, schedule: Schedule) -> None:
        if isinstance(event, FileEntry):
            await self._channels[event.topic.name].put(event, schedule.shifted(event.time))
            return
        channel = self._channels.get(event.channel)  # None: no item of this topic is played
        if isinstance(event, FileAdvance):
            if channel is not None:
                await channel.advance(schedule.shifted(self._promised(event.time, schedule)))
            return
        if channel is not None:
            channel.note_gap(event)
        if not self._rounds and len(self._gaps) < GAPS_KEPT_MAX:
            self._gaps.append(event)

    def _promised(self, time: int, schedule: Schedule) -> int:
        """The instant of an advance. In a loop the next round begins at the end of this one, so no advance is later."""
        return min(time, schedule.end) if self._request.loop else time

    async def _flush(self) -> None:
        for one in self._channels.values():
            await one.flush()

    async def _collected(self) -> dict[str, int]:
        """See `ReplaySummary.collected`."""
        if self._request.speed:
            return {}
        counts = {one.name: await one.collected() for one in self._channels.values()}
        return {name: count for name, count in counts.items() if count}

    def _summarize(self, collected: Mapping[str, int]) -> ReplaySummary:
        channels = self._channels.values()
        return ReplaySummary(
            path=self._source.path,
            items={one.name: one.accepted for one in channels},
            refused=sum(one.refused for one in channels),
            first_refusal=next((one.first_refusal for one in channels if one.first_refusal), ""),
            gaps=tuple(self._gaps),
            advances=sum(one.advances for one in channels),
            rounds=self._rounds,
            collected=collected,
            damaged=tuple(self._source.damaged),
        )


def _some(events: Iterator[tuple[int, Event]]) -> list[tuple[int, Event]]:
    return list(islice(events, EVENTS_PER_STEP))
