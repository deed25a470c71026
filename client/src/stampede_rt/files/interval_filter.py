"""The part of a file between two times. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from stampede_rt.files.chunk_content import Event, IncarnationKey
from stampede_rt.files.entries import TIME_MAX, FileAdvance, FileEntry
from stampede_rt.values.recording import RecordingGap
from stampede_rt.values.timeline import MAX_INSTANT

WAITING_MAX = 64  # the most events of a channel that wait for the end of a gap


class _Place(NamedTuple):
    """The place of an item. `latest` is the greatest time of the channel so far."""

    seq: int | None
    time: int
    latest: int


class IntervalFilter:
    """Keeps the events in an interval of time. `take` gets them.

    A gap is before the interval if its end and the next item are before the interval. A gap is after the interval if
    its start and the previous item are after the interval. The filter drops only these gaps. So a gap waits for the
    next item of its channel that is not late, and the events after the gap wait, too.
    """

    def __init__(self, start: int, end: int, chosen: Callable[[str], bool], take: Callable[[Any], object]) -> None:
        """`end`: exclusive; MAX_INSTANT: no end, because files of other programs may have later times."""
        self._start, self._end = start, end if end < MAX_INSTANT else TIME_MAX + 1
        self._chosen, self._take = chosen, take
        self._first: dict[IncarnationKey, _Place] = {}  # the first item of each channel and incarnation
        self._before: dict[IncarnationKey, _Place] = {}  # the last item so far
        self._waiting: dict[str, dict[int | None, list[Event]]] = {}

    def add(self, event: Event) -> None:
        """Keep or drop one event."""
        name = event.topic.name if isinstance(event, FileEntry) else event.channel
        if not self._chosen(name):
            return
        if isinstance(event, FileEntry):
            self._add_entry(name, event)
            return
        waiting = self._waiting.get(name, {}).get(event.incarnation)
        if waiting is not None:
            waiting.append(event)
        elif isinstance(event, RecordingGap):
            self._waiting.setdefault(name, {})[event.incarnation] = [event]
        elif event.time < self._end:
            self._take(event)

    def _add_entry(self, name: str, entry: FileEntry) -> None:
        key = (name, entry.topic.incarnation)
        before = self._before.get(key)
        is_late = before is not None and entry.time < before.latest
        for incarnation, waiting in list(self._waiting.get(name, {}).items()):
            if incarnation != key[1]:
                self._settle((name, incarnation), None)  # an item of the next incarnation ends the former one
            elif is_late and len(waiting) < WAITING_MAX:
                waiting.append(entry)
                return
            else:
                self._settle(key, None if is_late else entry.time)
        self._pass_on(key, entry)

    def _pass_on(self, key: IncarnationKey, entry: FileEntry) -> None:
        before = self._before.get(key)
        latest = entry.time if before is None else max(entry.time, before.latest)
        self._before[key] = place = _Place(entry.seq, entry.time, latest)
        self._first.setdefault(key, place)
        if self._start <= entry.time < self._end:
            self._take(entry)

    def _settle(self, key: IncarnationKey, next_time: int | None) -> None:
        for event in self._waiting.get(key[0], {}).pop(key[1], ()):
            if isinstance(event, FileEntry):
                self._pass_on(key, event)
            elif isinstance(event, FileAdvance):
                if event.time < self._end:
                    self._take(event)
            elif self._is_inside(event, key, next_time):
                self._take(event)

    def _is_inside(self, gap: RecordingGap, key: IncarnationKey, next_time: int | None) -> bool:
        before, first = self._before.get(key), self._first.get(key)
        before_time = None if before is None else before.time
        if _precedes(gap, before):  # a recovered file has this gap at its end, although the lost items came before
            before_time, next_time = None, first.time if _precedes(gap, first) and first is not None else None
        ends = [one for one in (gap.end, next_time) if one is not None]
        begins = [one for one in (gap.start, before_time) if one is not None]
        return (not ends or max(ends) >= self._start) and (not begins or min(begins) < self._end)

    def finish(self) -> None:
        """Decide on the last gaps."""
        for name, waiting in self._waiting.items():
            for incarnation in list(waiting):
                self._settle((name, incarnation), None)


def _precedes(gap: RecordingGap, item: _Place | None) -> bool:
    """Whether the items of a gap came before an item."""
    return item is not None and item.seq is not None and gap.last_seq is not None and gap.last_seq < item.seq
