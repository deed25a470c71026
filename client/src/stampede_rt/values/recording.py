"""The values of recordings: gaps, and the counts of each recorded channel. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

GAPS_KEPT_MAX = 1000  # the most gaps of one channel in a summary; the file itself names all
UNEXPLAINED = "UNEXPLAINED"
NOT_READ = "NOT_READ"


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingGap:
    """Items of a channel that a recording lacks.

    - `reason`: "COLLECTED" (retention took the items before the recorder read them), "LOST" (their host was lost),
      "DELETED" (the channel was deleted), "NOT_READ" (the recording ended first), "DAMAGED" (the file was damaged
      there), "UNEXPLAINED" (the host accepted the items, and sent neither them nor a reason). `detail` explains it.
    - `first_seq` and `last_seq` enclose the missing items; None: not known. `items` is their number; None: not known.
    - `start` and `end` are the bounds of the time in which items may be missing, in nanoseconds; None: not known.
    """

    channel: str
    incarnation: int
    reason: str
    detail: str
    first_seq: int | None = None
    last_seq: int | None = None
    items: int | None = None
    start: int | None = None
    end: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the gap as a JSON object. The incarnation is text, because it may exceed the integers of JSON."""
        return asdict(self) | {"incarnation": str(self.incarnation)}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> RecordingGap:
        """Return the gap of a JSON object. Raises ValueError, KeyError or TypeError if the object is not a gap."""
        numbers = {name: _whole(value.get(name)) for name in ("first_seq", "last_seq", "items", "start", "end")}
        return cls(
            channel=str(value["channel"]),
            incarnation=incarnation_of(value["incarnation"]),
            reason=str(value["reason"]),
            detail=str(value.get("detail", "")),
            **numbers,
        )


def _whole(value: Any) -> int | None:
    return None if value is None else whole_number(value)


def whole_number(value: Any) -> int:
    """Return a whole number of JSON that fits into 64 bits. Raises ValueError for anything else."""
    if type(value) is not int or not -(2**63) <= value < 2**64:
        raise ValueError(f"{str(value)[:40]!r} is not a whole number of 64 bits")
    return value


def incarnation_of(value: Any) -> int:
    """Return an incarnation, which is text in JSON. Raises ValueError for anything else."""
    if not (isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 20):
        raise ValueError(f"{str(value)[:40]!r} is not an incarnation")
    return whole_number(int(value))


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedCounts:
    """One incarnation of a channel in a recording: `accepted == recorded + missing`, always.

    - `accepted` counts the items that the host accepted and that belong to the recording, `recorded` the items in the
      file, and `missing` the items that the gaps name. `gaps` has the first 1000 gaps. A gap whose number of items is
      not known counts as 0 in `missing`; even so, `complete` is then False.
    - `first_seq` and `last_seq` are the seqs of the first and last recorded item, `start` and `end` their least and
      greatest time. None without items. `advance` is the channel's last advance in the recording.
    """

    channel: str
    incarnation: int
    accepted: int
    recorded: int
    missing: int
    gaps: Sequence[RecordingGap]
    gap_count: int
    payload_bytes: int
    first_seq: int | None
    last_seq: int | None
    start: int | None
    end: int | None
    advance: int | None = None

    @property
    def complete(self) -> bool:
        """Whether the file has every item that belongs to the recording."""
        return not self.gap_count

    def to_json(self) -> dict[str, Any]:
        """Return the counts as a JSON object."""
        gaps = [gap.to_json() for gap in self.gaps]
        return asdict(self) | {"incarnation": str(self.incarnation), "gaps": gaps}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> RecordedCounts:
        """Return the counts of a JSON object. Raises ValueError, KeyError or TypeError if the object has none."""
        counts: dict[str, Any] = {name: _whole(value[name]) or 0 for name in _COUNTS}
        counts |= {name: _whole(value[name]) for name in ("first_seq", "last_seq", "start", "end")}
        counts["advance"] = _whole(value.get("advance"))
        gaps = tuple(RecordingGap.from_json(gap) for gap in value["gaps"][:GAPS_KEPT_MAX])
        return cls(channel=str(value["channel"]), incarnation=incarnation_of(value["incarnation"]), gaps=gaps, **counts)


_COUNTS = ("accepted", "recorded", "missing", "gap_count", "payload_bytes")


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingSummary:
    """The contents of a finished recording. `path` is the file.

    `absent` lists the names and globs that matched no channel, and channels that the recording could not follow.
    `damaged` says which items a recovered file may lack besides the gaps of its channels. `complete` is False if
    anything is missing.
    """

    path: str
    channels: Sequence[RecordedCounts]
    absent: Sequence[str] = ()
    damaged: Sequence[str] = ()

    @property
    def complete(self) -> bool:
        """Whether nothing is missing."""
        return not self.absent and not self.damaged and all(one.complete for one in self.channels)

    @property
    def recorded(self) -> int:
        """The number of recorded items of all channels."""
        return sum(one.recorded for one in self.channels)

    @property
    def missing(self) -> int:
        """The number of missing items of all channels, as far as it is known."""
        return sum(one.missing for one in self.channels)


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplaySummary:
    """The items that a replay or an import has put into channels.

    - `items` counts the accepted items by channel, `refused` the items that the hosts have refused; `first_refusal` is
      the error text of the first one.
    - `gaps` has the first 1000 gaps of the played part of the file. The first item after each gap got the attribute
      `stampede.gap`. `damaged` says which items or channels the file may lack besides these gaps: `absent` and
      `damaged` of its `RecordingSummary`.
    - `advances` counts the advances, and `rounds` how many times the file was played to its end.
    - `collected` counts by channel the items that the limits of the channel have collected since the beginning of an
      import, or of a replay without pauses. It leaves out recorded channels, whose archive has the items. It is empty
      for other replays.
    """

    path: str
    items: Mapping[str, int]
    refused: int
    first_refusal: str
    gaps: Sequence[RecordingGap]
    advances: int
    rounds: int
    collected: Mapping[str, int] = field(default_factory=dict)
    damaged: Sequence[str] = ()

    @property
    def complete(self) -> bool:
        """Whether nothing is missing: the file names no missing items, and the channels have all items of the file."""
        return not (self.refused or self.collected or self.gaps or self.damaged)
