"""The contents of one chunk of a file, in the order in which the hosts of its channels had them. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from stampede_rt.files.entries import FileAdvance, FileEntry
from stampede_rt.values.recording import RecordingGap

Event = FileEntry | RecordingGap | FileAdvance
"""A part of the record of a channel: an item, a gap or an advance."""
IncarnationKey = tuple[str, int | None]  # a channel's name and its incarnation
_Waiting = dict[IncarnationKey, list[tuple[float, Event]]]


@dataclass(slots=True)
class ChunkContent:
    """The contents of one chunk.

    `unknown` counts messages whose topic the file does not name, and `bare` counts messages without facts. `places` has
    the place of each incarnation in the file: an earlier incarnation of a channel has a lesser one. `messages` counts
    the messages by the number of their topic in the file. `is_indexed`: the index of the file names this chunk at this
    place, or the file has no index.
    """

    offset: int
    end: int
    entries: list[FileEntry] = field(default_factory=list)
    gaps: Sequence[RecordingGap] = ()
    advances: Sequence[FileAdvance] = ()
    unknown: int = 0
    bare: int = 0
    places: Mapping[IncarnationKey, int] = field(default_factory=dict)
    messages: Mapping[int, int] = field(default_factory=dict)
    is_indexed: bool = True

    def in_host_order(self) -> Iterator[Event]:
        """Yield messages, gaps and advances in the order in which the host had them, channel by channel."""
        waiting = self._waiting()
        left = Counter((one.topic.name, one.topic.incarnation) for one in self.entries) if waiting else Counter()
        older: dict[IncarnationKey, list[IncarnationKey]] = {}
        for entry in self.entries:
            key = (entry.topic.name, entry.topic.incarnation)
            if waiting and key not in older:
                older[key] = [one for one in waiting if one[0] == key[0] and self._is_before(one, key)]
            for former in older.get(key, ()):
                if not left[former]:
                    yield from (event for _, event in waiting.pop(former, ()))
            queue = waiting.get(key, [])
            while queue and entry.seq is not None and queue[0][0] < entry.seq:
                yield queue.pop(0)[1]
            yield entry
            left[key] -= 1
        for queue in waiting.values():
            yield from (event for _, event in queue)

    def _is_before(self, one: IncarnationKey, other: IncarnationKey) -> bool:
        """Whether an incarnation came before another one. An incarnation without a place had no item so far."""
        places = self.places
        return one in places and other in places and places[one] < places[other]

    def _waiting(self) -> _Waiting:
        """Return the gaps and advances of each channel, with the seq after which each belongs, in this order."""
        waiting: _Waiting = {}
        for gap in self.gaps:
            last = gap.last_seq if gap.last_seq is not None else float("inf")
            if gap.first_seq is None and gap.last_seq is None:  # before the first recorded item
                last = 0
            waiting.setdefault((gap.channel, gap.incarnation), []).append((last, gap))
        for advance in self.advances:
            waiting.setdefault((advance.channel, advance.incarnation), []).append((advance.after_seq, advance))
        for queue in waiting.values():
            queue.sort(key=lambda one: one[0])
        return waiting
