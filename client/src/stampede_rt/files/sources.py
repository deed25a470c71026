"""MCAP files as sources of items for replay and import, read in the order in which the items are put."""

from __future__ import annotations

import heapq
import json
import os
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.entries import FACTS_TOPIC, POLICY_KEY, TIME_MAX, FileEntry
from stampede_rt.files.file_index import FileIndex
from stampede_rt.files.file_source import Chosen, SourceTopic, check_unpacked
from stampede_rt.files.interval_filter import IntervalFilter
from stampede_rt.files.reading import FileReader
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT

CACHE_BYTES = 64 * 1024 * 1024  # the most bytes of decoded chunks


class McapSource:
    """An MCAP file with an index. Keeps one chunk of each topic in memory, and CACHE_BYTES of decoded chunks."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the file. Raises FileError, also if the file has no index."""
        self._reader = FileReader(path)
        self.path = self._reader.path
        index = self._reader.index
        if index is None or not index.chunks or not _names_messages(index) or not self._reader.indexes_all():
            self._reader.__exit__()
            raise _unplayable(self.path, index, self._reader.says_no_index)
        self._damaged = _damaged(self._reader)
        self._chunks = sorted(index.chunks, key=lambda one: one.chunk_start_offset)
        self._index = index
        self._cache: OrderedDict[int, dict[str, list[Event]]] = OrderedDict()
        self._cached_bytes = 0
        self._topics: dict[str, SourceTopic] = {}
        self._facts_ids = {number for number, topic in index.topics.items() if topic.name == FACTS_TOPIC}
        self._sum = self._reader.data_sum()
        self._summed = 0  # the chunks in this checksum
        self._is_compared = False  # whether this checksum has been compared with the one that the file states
        self._loose: dict[int, dict[str, list[Event]]] = {}  # see `_gaps_and_advances_at`; by the position of the chunk

    @property
    def damaged(self) -> Sequence[str]:
        """See `FileSource.damaged`. If `events` has found a wrong checksum, the last text says so."""
        return self._damaged

    def close(self) -> None:
        """Close the file."""
        self._reader.__exit__()

    def topics(self, chosen: Chosen) -> Sequence[SourceTopic]:
        """The chosen topics that have messages, by name."""
        policies = {
            topic.name: dict(topic.metadata).get(POLICY_KEY, "{}")
            for topic in self._index.topics.values()
            if topic.name != FACTS_TOPIC and chosen(topic.name)
        }
        for name, policy in policies.items():
            if name not in self._topics and (places := self._places_of(name)):
                start, end = self._bound(name, places, 1), self._bound(name, places, -1)
                if start is not None and end is not None:
                    self._topics[name] = SourceTopic(name=name, policy=_policy(policy), start=start, end=-end)
        return [self._topics[name] for name in sorted(policies) if name in self._topics]

    def first_time(self, name: str, start: int, end: int) -> int | None:
        """See `FileSource.first_time`. A late item may follow items with greater times, so this looks at all chunks.

        Raises the FileError that `events` would raise for the first item of the topic: a caller then gets it earlier.
        """
        places, end = self._places_of(name), end if end < MAX_INSTANT else TIME_MAX + 1
        found = self._bound(name, places, 1, start, end)
        if found is not None:
            self._check_first(name, places, start, end)
        return found

    def _check_first(self, name: str, places: set[int], start: int, end: int) -> None:
        for place in sorted(places):
            first, last = self._chunks[place].message_start_time, self._chunks[place].message_end_time
            if first and (last < start or first >= end):
                continue
            for event in self._decoded(place).get(name, ()):
                if isinstance(event, FileEntry) and start <= event.time < end:
                    check_unpacked(self.path, event)
                    return

    def _bound(
        self, name: str, places: set[int], sign: int, start: int = MIN_INSTANT, end: int = TIME_MAX + 1
    ) -> int | None:
        """Return the first time of a topic if `sign` is 1, or its last time multiplied by -1 if `sign` is -1.

        Only items with a time from `start` on and before `end` count. Returns None if there are none. The index has the
        times of each chunk, and other topics may share the chunk. So this decodes the first or the last chunks of the
        topic, until no other chunk can change the result.
        """
        best: int | None = None
        for least, bound, place in sorted((*self._chunk_bounds(place, sign), place) for place in places):
            if best is not None and best <= least:
                break
            found = self._bound_in_chunk(name, place, sign, start, end, bound)
            if found is not None:
                best = found if best is None else min(best, found)
        return best

    def _bound_in_chunk(self, name: str, place: int, sign: int, start: int, end: int, bound: int) -> int | None:
        chunk = self._chunks[place]
        first, last = chunk.message_start_time, chunk.message_end_time
        if first and (last < start or first >= end):
            return None
        if bound and start <= first and last < end and not self._is_shared(place, name):
            return bound
        try:
            events = self._decoded(place).get(name, ())
        except FileError:  # `events` raises it if this topic is chosen
            return bound
        times = [one.time for one in events if isinstance(one, FileEntry)]
        return min((sign * one for one in times if start <= one < end), default=None)

    def _chunk_bounds(self, place: int, sign: int) -> tuple[int, int]:
        """Return the least possible result for a chunk, and the result of the index.

        In the index the time of an item before 1970 is 0.
        """
        chunk = self._chunks[place]
        bound = chunk.message_start_time if sign > 0 else -chunk.message_end_time
        return MIN_INSTANT if sign > 0 and not bound else bound, bound

    def _is_shared(self, place: int, name: str) -> bool:
        """Whether a chunk has messages of other topics, too."""
        ids = self._chunks[place].message_index_offsets
        return any(self._index.topics[one].name not in (name, FACTS_TOPIC) for one in ids if one in self._index.topics)

    def events(self, chosen: Chosen, start: int, end: int) -> Iterator[tuple[int, Event]]:
        """Yield the events of all chosen topics, merged by time. Each topic keeps the order of the file.

        At the end come the gaps of channels without an item in the file. Then this compares the checksum of the data,
        which needs the bytes of all chunks, also of those before `start`.
        """
        names = {topic.name for topic in self._index.topics.values() if topic.name != FACTS_TOPIC}
        places = {name: found for name in sorted(names) if chosen(name) and (found := self._places_of(name))}
        begins = {name: self._begin(found, start) for name, found in places.items()}
        streams = [
            self._events_of(name, number, begins[name], found, start, end)
            for number, (name, found) in enumerate(places.items())
        ]
        due = start
        for due, _, event in heapq.merge(*streams, key=lambda one: one[:2]):
            yield due, event
        kept: list[Event] = []
        window = IntervalFilter(start, end, lambda name: chosen(name) and name not in places, kept.append)
        for place in range(min(begins.values(), default=0), len(self._chunks)):
            for events in self._gaps_and_advances_at(place).values():
                for event in events:
                    window.add(event)
        window.finish()
        yield from ((due, event) for event in kept)
        self._compare_sum()

    def _compare_sum(self) -> None:
        if not self._is_compared and not self._sum.is_stated_at(self._index.data_end):
            self._damaged = (*self._damaged, _changed(self.path))
        self._is_compared = True

    def _add_to_sum(self, place: int) -> None:
        """Add a chunk that has been read to the checksum, if all chunks before it are in the checksum."""
        if place == self._summed:
            self._sum.read_to(self._chunks[place].chunk_start_offset + self._chunks[place].chunk_length)
            self._summed += 1

    def _places_of(self, name: str) -> set[int]:
        """Return the positions of the chunks that have items of a topic."""
        ids = {key for key, topic in self._index.topics.items() if topic.name == name}
        return {at for at, one in enumerate(self._chunks) if not ids.isdisjoint(one.message_index_offsets)}

    def _begin(self, places: set[int], start: int) -> int:
        """Return the position of the chunk at which the reading of a topic begins.

        This is the last chunk that comes before all items from `start` on. Reading begins there because a gap between
        this chunk and the first such item may reach beyond `start`.
        """
        before = 0
        for at in sorted(places):
            if not 0 < self._chunks[at].message_end_time < start:
                break
            before = at
        return before

    def _events_of(
        self, name: str, number: int, begin: int, places: set[int], start: int, end: int
    ) -> Iterator[tuple[int, int, Event]]:
        """Yield the events of one topic in the order of the file.

        Each comes with the greatest time of all items of the topic up to this event, and with `number`.
        """
        kept: list[Event] = []
        due, window = start, IntervalFilter(start, end, lambda _: True, kept.append)
        for place in range(begin, len(self._chunks)):
            found = self._decoded(place) if place in places else self._gaps_and_advances_at(place)
            self._add_to_sum(place)
            for event in found.get(name, ()):
                window.add(event)
                for one in kept:
                    if isinstance(one, FileEntry):
                        check_unpacked(self.path, one)
                        due = max(due, one.time)
                    yield due, number, one
                kept.clear()
        window.finish()
        yield from ((due, number, event) for event in kept)

    def _gaps_and_advances_at(self, place: int) -> dict[str, list[Event]]:
        """Return the gaps and advances of the channels without an item in a chunk. They stay in memory."""
        found = self._loose.get(place)
        if found is None:
            has_facts = not self._facts_ids.isdisjoint(self._chunks[place].message_index_offsets)
            found = self._loose[place] = _without_items(self._decoded(place)) if has_facts else {}
        return found

    def _decoded(self, place: int) -> dict[str, list[Event]]:
        """Return the events of a chunk by topic."""
        found = self._cache.get(place)
        if found is not None:
            self._cache.move_to_end(place)
            return found
        chunk = self._chunks[place]
        found = _by_topic(self._reader.content_at(chunk.chunk_start_offset))
        self._cache[place] = found
        self._cached_bytes += chunk.uncompressed_size
        while self._cached_bytes > CACHE_BYTES and len(self._cache) > 1:
            old, _ = self._cache.popitem(last=False)
            self._cached_bytes -= self._chunks[old].uncompressed_size
        return found


def _names_messages(index: FileIndex) -> bool:
    """Whether the index says which topics have messages in each chunk."""
    return all(
        index.topics.keys() >= one.message_index_offsets.keys()
        and (one.message_index_offsets or not one.message_end_time)  # a chunk without messages has no times
        for one in index.chunks
    )


def _unplayable(path: str, index: FileIndex | None, says_no_index: bool) -> FileError:
    if index is not None and index.statistics is not None and not index.statistics.message_count:
        return FileError(f"the file {path!r} cannot be played: it has no items")
    if index is None and not says_no_index:
        return FileError(
            f"the file {path!r} cannot be played: its end is missing or damaged, so it may lack items; "
            "`stampede file recover` saves the readable part"
        )
    return FileError(
        f"the file {path!r} cannot be played: it has no index of all its messages; `stampede file merge` writes a file "
        "with such an index"
    )


def _changed(path: str) -> str:
    return (
        f"the bytes of the file {path!r} do not have the checksum that the file states, so items may be missing, "
        "changed or repeated, or metadata may have changed; `stampede file verify` may find the place"
    )


def _damaged(reader: FileReader) -> Sequence[str]:
    try:
        summary = reader.summary()
    except FileError as error:
        return (error.message,)
    return () if summary is None else (*summary.absent, *summary.damaged)


def _by_topic(content: ChunkContent) -> dict[str, list[Event]]:
    found: dict[str, list[Event]] = {}
    for event in content.in_host_order():
        name = event.topic.name if isinstance(event, FileEntry) else event.channel
        found.setdefault(name, []).append(event)
    return found


def _without_items(found: Mapping[str, list[Event]]) -> dict[str, list[Event]]:
    return {name: events for name, events in found.items() if not any(isinstance(one, FileEntry) for one in events)}


def _policy(text: str) -> Mapping[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
