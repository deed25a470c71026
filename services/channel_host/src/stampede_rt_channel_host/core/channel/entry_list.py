"""Index entries in the order of one of their numbers. Pure.

Nearly all entries come in order and leave in order, and a search reads few entries. This list makes these steps short,
where a sorted list of a library takes several times as long (decision 0232). It keeps the entries in chunks, so that an
entry that comes late moves at most the references of one chunk.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from itertools import chain
from operator import attrgetter

from stampede_rt_channel_host.core.channel.index_entries import Entry

CHUNK_ENTRIES = 512

_seq_of = attrgetter("first_seq")
Place = tuple[int, int]
"""The number of a chunk, and a position in it. The place behind all entries is (number of chunks, 0)."""


class EntryList:
    """Entries in ascending order of a key. Of equal keys the entry that was added later comes later."""

    __slots__ = ("_chunks", "_key", "_keys", "_lasts", "_length")

    def __init__(self, key: Callable[[Entry], int]) -> None:
        """`key` returns a number of an entry, which must not change."""
        self._key = key
        self._chunks: list[list[Entry]] = []
        self._keys: list[list[int]] = []  # the keys of each chunk
        self._lasts: list[int] = []  # the last key of each chunk
        self._length = 0

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[Entry]:
        return chain.from_iterable(self._chunks)

    @property
    def first(self) -> Entry | None:
        """The first entry, or None."""
        return self._chunks[0][0] if self._chunks else None

    @property
    def last(self) -> Entry | None:
        """The last entry, or None."""
        return self._chunks[-1][-1] if self._chunks else None

    def nth(self, at: int) -> Entry | None:
        """The entry at position `at`, or None. One step for each chunk before it."""
        for chunk in self._chunks:
            if at < len(chunk):
                return chunk[at]
            at -= len(chunk)
        return None

    def add(self, entry: Entry) -> None:
        """Add an entry."""
        key, lasts = self._key(entry), self._lasts
        self._length += 1
        if not lasts or (key >= lasts[-1] and len(self._keys[-1]) >= CHUNK_ENTRIES):
            self._chunks.append([entry])
            self._keys.append([key])
            lasts.append(key)
        elif key >= lasts[-1]:
            self._chunks[-1].append(entry)
            self._keys[-1].append(key)
            lasts[-1] = key
        else:
            self._insert(key, entry)

    def _insert(self, key: int, entry: Entry) -> None:
        number, at = self._place(key, bisect_right)
        chunk, keys = self._chunks[number], self._keys[number]
        chunk.insert(at, entry)
        keys.insert(at, key)
        if len(keys) > 2 * CHUNK_ENTRIES:
            self._chunks[number : number + 1] = chunk[:CHUNK_ENTRIES], chunk[CHUNK_ENTRIES:]
            self._keys[number : number + 1] = keys[:CHUNK_ENTRIES], keys[CHUNK_ENTRIES:]
            self._lasts.insert(number, keys[CHUNK_ENTRIES - 1])

    def remove_first(self) -> None:
        """Remove the first entry. There must be one."""
        self._delete((0, 0))

    def remove(self, entry: Entry) -> None:
        """Remove an entry, which must be in the list. One step for each earlier entry of the same key."""
        key = self._key(entry)
        number, at = self._place(key, bisect_left)
        while self._chunks[number][at] is not entry:
            number, at = (number, at + 1) if at + 1 < len(self._chunks[number]) else (number + 1, 0)
        self._delete((number, at))

    def _delete(self, place: Place) -> None:
        number, at = place
        keys = self._keys[number]
        del self._chunks[number][at], keys[at]
        self._length -= 1
        if not keys:
            del self._chunks[number], self._keys[number], self._lasts[number]
        elif at == len(keys):
            self._lasts[number] = keys[-1]

    def last_up_to(self, key: int) -> Entry | None:
        """The last entry at or below `key`, or None."""
        if self._lasts and self._lasts[-1] <= key:
            return self._chunks[-1][-1]
        return self._before(self._place(key, bisect_right))

    def only_up_to(self, key: int) -> tuple[Entry, int | None] | None:
        """The last entry at or below `key`, if no other entry has its key, and the key of the entry after it.

        None: no such entry. The key is None if there is no entry after it.
        """
        number, at = self._place(key, bisect_right)
        following = self._keys[number][at] if number < len(self._keys) else None
        if not at:
            number, at = number - 1, len(self._keys[number - 1]) if number else 0
        if not at:
            return None
        keys = self._keys[number]
        before = keys[at - 2] if at > 1 else self._lasts[number - 1] if number else None
        return None if keys[at - 1] == before else (self._chunks[number][at - 1], following)

    def last_below(self, key: int) -> Entry | None:
        """The last entry below `key`, or None."""
        return self._before(self._place(key, bisect_left))

    def first_above(self, key: int) -> Entry | None:
        """The first entry above `key`, or None."""
        number, at = self._place(key, bisect_right)
        return self._chunks[number][at] if number < len(self._chunks) else None

    def between(self, low: int, high: int, seq: int = 0) -> Iterator[Entry]:
        """The entries from `low` to `high`, both inclusive. The list must not change during the iteration.

        `seq`: leaves out the entries of `low` whose items are all below this seq.
        """
        begin = self._place_in_bucket(low, seq) if seq else self._place(low, bisect_left)
        return self._range(begin, self._place(high, bisect_right))

    def between_down(self, low: int, high: int, seq: int | None = None) -> Iterator[Entry]:
        """Like `between`, but the last entry first. `seq`: leave out the entries of `high` that begin above it."""
        begin, end = self._place(low, bisect_left), self._place(high, bisect_right)
        if seq is not None and begin < end:
            number, at = self._place_in_bucket(high, seq)
            end = min(end, (number, at + 1))
        return self._range_down(begin, end)

    def _place(self, key: int, bisect: Callable[..., int]) -> Place:
        """The place of the first entry that is at or above `key` (bisect_left), or above it (bisect_right)."""
        number = bisect(self._lasts, key)
        return number, bisect(self._keys[number], key) if number < len(self._keys) else 0

    def _before(self, place: Place) -> Entry | None:
        number, at = place
        if at:
            return self._chunks[number][at - 1]
        return self._chunks[number - 1][-1] if number else None

    def _place_in_bucket(self, key: int, seq: int) -> Place:
        """The place of the last entry of `key` whose first seq is at most `seq`.

        If there is none, the place of the first entry at or above `key`. Bisects, because a bucket may hold any number
        of entries. Entries of equal keys must stand in the order of their seqs.
        """
        (number, at), (last, end) = self._place(key, bisect_left), self._place(key, bisect_right)
        begins = range(number + 1, last + 1 if end else last)  # the further chunks that begin with entries of the key
        further = bisect_right(begins, seq, key=lambda begin: self._chunks[begin][0].first_seq)
        if further:
            number, at = number + further, 0
        if number == len(self._chunks):
            return number, 0
        above = bisect_right(self._chunks[number], seq, at, end if number == last else None, key=_seq_of)
        return number, max(above - 1, at)

    def _range(self, begin: Place, end: Place) -> Iterator[Entry]:
        """The entries from one place up to another one, exclusive. Copies nothing."""
        (first, at), (last, before) = begin, end
        if begin >= end:
            return iter(())
        get = self._chunks[first].__getitem__
        if first == last:
            return map(get, range(at, before))
        whole = chain.from_iterable(map(self._chunks.__getitem__, range(first + 1, last)))
        rest = map(self._chunks[last].__getitem__, range(before)) if before else ()
        return chain(map(get, range(at, len(self._chunks[first]))), whole, rest)

    def _range_down(self, begin: Place, end: Place) -> Iterator[Entry]:
        """Like `_range`, but the last entry first."""
        (first, at), (last, before) = begin, end
        if begin >= end:
            return iter(())
        get = self._chunks[first].__getitem__
        if first == last:
            return map(get, range(before - 1, at - 1, -1))
        whole = chain.from_iterable(map(reversed, map(self._chunks.__getitem__, range(last - 1, first, -1))))
        rest = map(self._chunks[last].__getitem__, range(before - 1, -1, -1)) if before else ()
        return chain(rest, whole, map(get, range(len(self._chunks[first]) - 1, at - 1, -1)))
