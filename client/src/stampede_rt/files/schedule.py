"""The schedule of a replay: when it puts each item of a file, and with which time. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import OVERLAP_NANOS_MAX
from stampede_rt.values.policy import ARCHIVE_BYTES_MIN, FOREVER_NANOS
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, format_instant, parse_duration

SHIFT_NOW = "now"
SPEED_MAX = 1e6
MAX_BYTES_DEFAULT = 256 * 1024 * 1024  # for a channel that a replay creates without another limit
MARGIN_NANOS = 10_000_000_000  # a new channel keeps items for this time longer than the replay's own delay


def window_text(start: int | None, end: int | None) -> str:
    """The times of a replay, to follow "no items" in an error; empty if neither end was stated."""
    since = "" if start in (None, MIN_INSTANT) else f" from {format_instant(start or 0)} on"
    return since if end in (None, MAX_INSTANT) else f"{since}{' and' * bool(since)} before {format_instant(end or 0)}"


@dataclass(frozen=True, slots=True)
class Schedule:
    """A replay of the items with times from `start` to `end`, which begins at the instant `began`.

    `speed` 2 is twice as fast as the recording, and 0 as fast as possible. `shift` is added to the time of each item.
    All times are in nanoseconds.
    """

    start: int
    end: int
    speed: float
    began: int
    shift: int

    @classmethod
    def plan(cls, start: int, end: int, speed: float, shift: int | str | None, now: int) -> Schedule:
        """Return the schedule. With `shift` "now" no item is ahead of the clock when it is put.

        A replay that is shorter than the recording puts its last item with the time of the clock, and its first item
        with a time in the past. A longer replay puts its first item with the time of the clock.
        Raises InvalidArgument if no channel can have such a time.
        """
        length = end - start
        moved = 0 if shift is None else shift
        if shift == SHIFT_NOW:
            takes = 0 if speed == 0 else round(length / speed)
            moved = now - start - max(0, length - takes)
        first, last = start + int(moved), end + int(moved)
        if first < MIN_INSTANT or last > MAX_INSTANT:
            raise InvalidArgument(
                f"the items would get times from {first} to {last} ns since 1970, and channels take "
                f"times from {MIN_INSTANT} to {MAX_INSTANT}; choose another shift, or another part of the file"
            )
        return cls(start, end, speed, now, int(moved))

    def due_nanos(self, time: int) -> int:
        """Return the time from the beginning of the replay until it puts an item with the time `time`."""
        return 0 if self.speed == 0 else round(max(0, time - self.start) / self.speed)

    @property
    def lag_nanos(self) -> int:
        """The greatest time by which a shifted item is behind the clock when it is put."""
        length = self.end - self.start
        takes = 0 if self.speed == 0 else round(length / self.speed)
        return abs(length - takes)

    def shifted(self, time: int) -> int:
        """Return the time with which an item is put."""
        return min(max(time + self.shift, MIN_INSTANT), MAX_INSTANT)  # an advance may be later than all items


def parse_shift(shift: object) -> int | str | None:
    """Return a shift in nanoseconds, "now", or None for times as recorded. Raises InvalidArgument."""
    if shift is None or shift == SHIFT_NOW:
        return None if shift is None else SHIFT_NOW
    return parse_duration(shift, "shift")  # type: ignore[arg-type]  # parse_duration checks the type


def parse_speed(speed: object) -> float:
    """Return a speed; 0 means as fast as possible. Raises InvalidArgument."""
    if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0 <= speed <= SPEED_MAX:
        raise InvalidArgument(f"speed is {speed!r}; write a number such as 2.0, or 0 for as fast as possible")
    return float(speed)


def target_policy(
    recorded: Mapping[str, Any], shifted: bool, lag_nanos: int, *, keeps_all: bool, archived: bool
) -> dict[str, Any]:
    """Return the policy of a channel that a replay creates, as arguments of `Connection.channel`.

    The policy is the recorded one, without the fields about consumers, and with the archive only if `archived`. Without
    a shift the policy has no limit of age, because such a limit would refuse or delete the old items. With a shift the
    limits of age are longer by the lag. If the channel `keeps_all` items and has no archive, the policy has no
    max_items, and at least the default of max_bytes.
    """
    policy: dict[str, Any] = {name: _count(recorded.get(name)) for name in ("max_bytes", "max_items")}
    max_age, overlap = _count(recorded.get("max_age_nanos")), _count(recorded.get("overlap_nanos"))
    margin = lag_nanos + (MARGIN_NANOS if lag_nanos else 0)
    archive = _archive(recorded, margin if shifted else None) if archived else {}
    if keeps_all and not archive:
        policy |= {"max_items": None, "max_bytes": max(policy["max_bytes"] or 0, MAX_BYTES_DEFAULT)}
    if shifted and max_age is not None:
        policy["max_age"] = f"{min(max_age + margin, MAX_INSTANT)} ns"
    elif policy["max_bytes"] is None:
        policy["max_bytes"] = MAX_BYTES_DEFAULT
    if overlap is not None and overlap <= OVERLAP_NANOS_MAX:
        policy["overlap"] = f"{overlap} ns"
    if (future := _count(recorded.get("max_future_nanos"))) is not None:
        policy["max_future"] = f"{future} ns"
    return policy | archive | _content_type(recorded.get("content_type"))


def _archive(recorded: Mapping[str, Any], margin: int | None) -> dict[str, Any]:
    """Return the limits of the archive; empty: no archive.

    The limit of time is longer than the recorded limit by `margin`. If `margin` is None, the archive has no such limit.
    """
    kept, size = _count(recorded.get("archive_nanos"), FOREVER_NANOS), _count(recorded.get("archive_bytes"))
    if kept is None and size is None:
        return {}
    time = None if kept is None else "forever"
    if kept is not None and kept != FOREVER_NANOS and margin is not None:
        time = f"{min(kept + margin, MAX_INSTANT)} ns"
    return {"archive": time, "archive_bytes": None if size is None else max(size, ARCHIVE_BYTES_MIN)}


def _content_type(kind: object) -> dict[str, str]:
    known = isinstance(kind, str) and kind.isascii() and 0 < len(kind) <= 255
    return {"content_type": kind} if known and isinstance(kind, str) else {}


def _count(value: object, most: int = 2**62 - 1) -> int | None:
    """Return a number of a policy; None if no policy may have it. The file may be of another program."""
    return value if type(value) is int and 0 < value <= most else None
