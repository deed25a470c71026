"""Fills item runs and requests on the producer's side. Pure except for the encoding of a finished run."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, NamedTuple

from stampede_rt.pacing.crediting import ITEM_OVERHEAD_BYTES
from stampede_rt.values.answers import ABSENT
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.request_pieces import JOINED_BYTES_MAX
from stampede_rt.wire.runs import RUN_BYTES_MAX, run_parts

_FRAMING_BYTES = 32  # the most bytes that a request needs around one run
WaitingItem = tuple[bytes, int | None, int | None, Mapping[str, str] | None, str]
"""A payload with its time, its duration, its attributes and its content type."""
REQUEST_RUNS_MAX = 16  # the host judges the runs of a request in one step, in about a millisecond


@dataclass(frozen=True, slots=True)
class NumberedRun:
    """A finished run, with the producer's number of its first item and the length of its payloads.

    `encoded` has the bytes of the run in pieces, as `run_parts` returns them. `request_bytes`: the most bytes that the
    run takes in a request. `cut_before_bytes`: the sum of `charged_bytes` of all runs that were cut before it.
    """

    first_number: int
    items: int
    length_bytes: int
    encoded: Sequence[bytes]
    request_bytes: int
    cut_before_bytes: int = 0

    @property
    def charged_bytes(self) -> int:
        """The bytes of the payloads, and 64 bytes for each item."""
        return self.length_bytes + self.items * ITEM_OVERHEAD_BYTES


class RunBuilder:
    """Collects items, and makes runs of them. Only one caller at a time may `cut` or `drop`. Others may `add` then.

    Items fit together in one run if all or none of them have a time, if their attributes and content types are equal,
    and if the run stays within its limits. The builder numbers the items of all its runs.
    """

    __slots__ = ("_cut_bytes", "_waiting", "length_bytes")

    def __init__(self) -> None:
        self._waiting: list[Any] = [1]  # the number of the first waiting item, and then the items: see `drop`
        self._cut_bytes = 0  # see `NumberedRun.cut_before_bytes`
        self.length_bytes = 0  # the bytes of the waiting payloads; a little wrong if two callers add at the same moment

    def __len__(self) -> int:
        return len(self._waiting) - 1

    @property
    def next_number(self) -> int:
        """The number of the first item that is in no run yet."""
        number: int = self._waiting[0]
        return number

    def has_room(self, length_bytes: int) -> bool:
        """Whether a payload of this length may wait together with the present ones."""
        items = len(self._waiting) - 1
        return not items or (items < RUN_ITEMS_MAX and self.length_bytes + length_bytes <= RUN_BYTES_MAX)

    def add_within(self, item: WaitingItem, length_bytes: int) -> bool:
        """Append an item if `has_room` is True. Returns whether it was appended. See `add`."""
        waiting, before_bytes = self._waiting, self.length_bytes
        if len(waiting) > 1 and (len(waiting) > RUN_ITEMS_MAX or before_bytes + length_bytes > RUN_BYTES_MAX):
            return False
        self.length_bytes = before_bytes + length_bytes
        waiting.append(item)
        return True

    def add(self, item: WaitingItem, length_bytes: int) -> None:
        """Append an item, with the length of its payload. Call `has_room` first.

        One operation of the interpreter adds the item, so no thread, signal handler or exception finds it half added.
        """
        self.length_bytes += length_bytes
        self._waiting.append(item)

    def cut(self) -> NumberedRun:
        """Return a run of the first waiting items that fit together, encoded. The items wait until `drop`.

        Call this only if an item waits.
        """
        number, *items = self._waiting[: RUN_ITEMS_MAX + 1]
        payloads, times, durations, attributes, content_types = zip(*_fitting(items), strict=True)
        has_durations = durations.count(None) < len(durations)
        encoded = run_parts(
            payloads,
            times=None if times[0] is None else times,
            durations=[ABSENT if one is None else one for one in durations] if has_durations else None,
            content_type=content_types[0],
            attributes=attributes[0],
        )
        request_bytes = sum(map(len, encoded)) + _FRAMING_BYTES
        length_bytes = sum(map(len, payloads))
        return NumberedRun(number, len(payloads), length_bytes, encoded, request_bytes, self._cut_bytes)

    def drop(self, run: NumberedRun | None) -> None:
        """Forget the items of `run`, which the last `cut` has returned. Does nothing if they were dropped before.

        One operation of the interpreter drops the items and sets the number of the next item. So an exception of a
        signal handler cannot separate these two changes.
        """
        if run is None or run.first_number < self.next_number:
            return
        self._cut_bytes = run.cut_before_bytes + run.charged_bytes
        self._waiting[: run.items + 1] = [run.first_number + run.items]
        self.length_bytes = max(self.length_bytes - run.length_bytes, 0) if len(self._waiting) > 1 else 0


def _fitting(items: list[WaitingItem]) -> list[WaitingItem]:
    """Return the first items that fit together in one run."""
    payloads, times, _, *labels = zip(*items, strict=True)
    is_alike = times.count(None) in (0, len(items)) and all(one.count(one[0]) == len(items) for one in labels)
    if is_alike and sum(map(len, payloads)) <= RUN_BYTES_MAX:
        return items  # nearly always; the loop takes several times as long
    _, first_time, _, first_attributes, first_type = items[0]
    length_bytes = 0
    for index, (payload, time, _, attributes, content_type) in enumerate(items):
        length_bytes += len(payload)
        is_alike = (time is None) is (first_time is None) and content_type == first_type
        if index and not (is_alike and attributes == first_attributes and length_bytes <= RUN_BYTES_MAX):
            return items[:index]
    return items


class AnsweredRuns(NamedTuple):
    """The items that the host has accepted and refused, up to and with the run `first_number`."""

    first_number: int
    accepted: int
    refused: int


class UnackedRuns:
    """The finished runs of a producer that the host has not acknowledged: first the sent ones, then the gathered ones.

    While sent runs wait for their acks, the next ones gather, up to a full request. One operation of the interpreter
    makes each change. So an exception of a signal handler leaves no run half added or half sent.
    """

    def __init__(self) -> None:
        self._runs: deque[NumberedRun] = deque()
        self._sent_before = 0  # the runs with lower numbers are sent
        self.answered = AnsweredRuns(0, 0, 0)

    def __len__(self) -> int:
        return len(self._runs)

    @property
    def length_bytes(self) -> int:
        """The bytes of the payloads, and 64 bytes for each item."""
        try:
            first, last = self._runs[0], self._runs[-1]
        except IndexError:  # another thread may have taken the last one just now
            return 0
        return last.cut_before_bytes + last.charged_bytes - first.cut_before_bytes

    @property
    def is_idle(self) -> bool:
        """Whether no sent run waits for its ack."""
        try:
            return self._runs[0].first_number >= self._sent_before
        except IndexError:  # no run waits; another thread may have taken the last one just now
            return True

    @property
    def last(self) -> NumberedRun | None:
        """The run that was added last; None if it is acknowledged."""
        return self._runs[-1] if self._runs else None

    def add(self, run: NumberedRun) -> None:
        """Add a run."""
        self._runs.append(run)

    def take_ready(self) -> list[list[NumberedRun]]:
        """Return the requests to send now: full ones, and all if no sent run waits for its ack.

        Their runs count as sent from now on.
        """
        requests = self._gathered()
        if requests and len(requests[-1]) < REQUEST_RUNS_MAX and not self.is_idle:
            requests.pop()
        return self._as_sent(requests)

    def take_gathered(self) -> list[list[NumberedRun]]:
        """Return all gathered runs in requests. They count as sent from now on."""
        return self._as_sent(self._gathered())

    def resend(self) -> list[list[NumberedRun]]:
        """Return all runs in requests, for a new stream. They count as sent."""
        return self._as_sent(list(in_requests(self._runs)))

    def _gathered(self) -> list[list[NumberedRun]]:
        gathered = [*takewhile(lambda run: run.first_number >= self._sent_before, reversed(self._runs))]
        return list(in_requests(reversed(gathered)))

    def _as_sent(self, requests: list[list[NumberedRun]]) -> list[list[NumberedRun]]:
        if requests:
            self._sent_before = requests[-1][-1].first_number + 1
        return requests

    def awaits(self, first_number: int) -> bool:
        """Whether the run with this number has been sent, and is the first one without an ack."""
        return not self.is_idle and self._runs[0].first_number == first_number

    @property
    def first(self) -> NumberedRun:
        """The run that was sent first. There must be a run."""
        return self._runs[0]

    def acknowledge(self, refused: int) -> None:
        """Count the host's answer to the run that was sent first, and remove the run. `refused`: items of this run.

        If a signal handler ends this call with an exception, repeat the call if `awaits` is True for the run's number.
        """
        run, (number, accepted, refused_before) = self._runs[0], self.answered
        if run.first_number > number:
            self.answered = AnsweredRuns(run.first_number, accepted + run.items - refused, refused_before + refused)
        self._runs.popleft()


def in_requests(runs: Iterable[NumberedRun]) -> Iterator[list[NumberedRun]]:
    """Yield the runs in their order, in groups that each fit into one request. A large run has a group of its own."""
    group: list[NumberedRun] = []
    group_bytes = 0
    for run in runs:
        run_bytes = run.request_bytes
        if group and (len(group) == REQUEST_RUNS_MAX or group_bytes + run_bytes > JOINED_BYTES_MAX):
            yield group
            group, group_bytes = [], 0
        group.append(run)
        group_bytes += run_bytes
    if group:
        yield group
