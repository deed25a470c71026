"""Fills item runs on the producer's side. Pure except for the encoding of a finished run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.runs import ABSENT, RUN_BYTES_MAX, encode_run


@dataclass(frozen=True, slots=True)
class NumberedRun:
    """A finished run, with the producer's number of its first item and the length of its payloads."""

    first_number: int
    items: int
    length_bytes: int
    encoded: bytes


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
        encoded = encode_run(
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
