"""Fills item runs and requests on the producer's side. Pure except for the encoding of a finished run."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from stampede_rt.pacing.crediting import ITEM_OVERHEAD_BYTES
from stampede_rt.values.model import ABSENT
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.request_pieces import JOINED_BYTES_MAX
from stampede_rt.wire.runs import RUN_BYTES_MAX, run_parts

_FRAMING_BYTES = 32  # the most bytes that a request needs around one run
REQUEST_RUNS_MAX = 16  # the host judges the runs of a request in one step, in about a millisecond


@dataclass(frozen=True, slots=True)
class NumberedRun:
    """A finished run, with the producer's number of its first item and the length of its payloads.

    `encoded` has the bytes of the run in pieces, as `run_parts` returns them.
    """

    first_number: int
    items: int
    length_bytes: int
    encoded: Sequence[bytes]

    @property
    def request_bytes(self) -> int:
        """The bytes of the run in a request, at most."""
        return sum(map(len, self.encoded)) + _FRAMING_BYTES


@dataclass(slots=True)
class RunBuilder:
    """Collects items that fit together in one run. The caller takes the run when it can send the run.

    Items fit together if all or none of them have a time, if their attributes and content types are equal, and if the
    run stays within its limits. The builder numbers the items of all its runs: the next item has `next_number`.
    """

    next_number: int = 1
    _payloads: list[bytes] = field(default_factory=list)
    _times: list[int] = field(default_factory=list)
    _durations: list[int] = field(default_factory=list)
    _attributes: Mapping[str, str] | None = None
    _content_type: str = ""
    length_bytes: int = 0

    def __len__(self) -> int:
        return len(self._payloads)

    def fits(self, payload: bytes, time: int | None, attributes: Mapping[str, str] | None, content_type: str) -> bool:
        """Whether the next item can join the present run."""
        if not self._payloads:
            return True
        return (
            len(self._payloads) < RUN_ITEMS_MAX
            and self.length_bytes + len(payload) <= RUN_BYTES_MAX
            and (time is None) is (not self._times)
            and (attributes or None) == self._attributes
            and content_type == self._content_type
        )

    def add(
        self,
        payload: bytes,
        time: int | None,
        duration: int | None,
        attributes: Mapping[str, str] | None,
        content_type: str,
    ) -> None:
        """Append an item to the present run. Call `fits` first."""
        if not self._payloads:
            self._attributes, self._content_type = attributes or None, content_type
        self._payloads.append(payload)
        if time is not None:
            self._times.append(time)
        self._durations.append(ABSENT if duration is None else duration)
        self.length_bytes += len(payload)

    def take(self) -> NumberedRun:
        """Return the present run, encoded, and begin the next one. Do not call it on an empty builder."""
        has_durations = any(duration != ABSENT for duration in self._durations)
        encoded = run_parts(
            self._payloads,
            times=self._times or None,
            durations=self._durations if has_durations else None,
            content_type=self._content_type,
            attributes=self._attributes,
        )
        run = NumberedRun(self.next_number, len(self._payloads), self.length_bytes, encoded)
        self.next_number += run.items
        self._payloads, self._times, self._durations, self.length_bytes = [], [], [], 0
        return run


class UnackedRuns:
    """The finished runs of a producer that the host has not acknowledged: first the sent ones, then the gathered ones.

    While sent runs wait for their acks, the next ones gather, up to a full request. `length_bytes` counts payloads, and
    64 bytes for each item.
    """

    def __init__(self) -> None:
        self._sent: deque[NumberedRun] = deque()
        self._gathered: list[NumberedRun] = []
        self.length_bytes = 0

    def __len__(self) -> int:
        return len(self._sent) + len(self._gathered)

    @property
    def is_idle(self) -> bool:
        """Whether no sent run waits for its ack. Then none is gathered either."""
        return not self._sent

    def add(self, run: NumberedRun) -> list[list[NumberedRun]]:
        """Add a run. Returns the requests to send now: full ones, and all if no sent run waits for its ack."""
        self.length_bytes += run.length_bytes + run.items * ITEM_OVERHEAD_BYTES
        *full, self._gathered = in_requests((*self._gathered, run))
        self._sent.extend(one for request in full for one in request)
        if self.is_idle or len(self._gathered) == REQUEST_RUNS_MAX:
            full.append(self.take_gathered())
        return full

    def take_gathered(self) -> list[NumberedRun]:
        """Return the gathered runs, which count as sent from now on."""
        runs, self._gathered = self._gathered, []
        self._sent.extend(runs)
        return runs

    def resend(self) -> Iterable[list[NumberedRun]]:
        """Return all runs in requests, for a new stream. They count as sent."""
        self.take_gathered()
        return in_requests(self._sent)

    def awaits(self, first_number: int) -> bool:
        """Whether the run with this number has been sent, and is the first one without an ack."""
        return bool(self._sent) and self._sent[0].first_number == first_number

    def acknowledge(self) -> NumberedRun:
        """Remove and return the run that was sent first."""
        run = self._sent.popleft()
        self.length_bytes -= run.length_bytes + run.items * ITEM_OVERHEAD_BYTES
        return run


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
