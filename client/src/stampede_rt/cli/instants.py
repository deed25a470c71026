"""Instants for people: in UTC, or with `--local` in the local time zone."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from stampede_rt.values.timeline import format_instant

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_shown = {"local": False}


def show_local(local: bool) -> None:
    """Set for this command whether `instant_text` shows local time."""
    _shown["local"] = local


def instant_text(instant: int) -> str:
    """Return an instant in nanoseconds as ISO 8601 with nanoseconds, in the time zone of this command."""
    if not _shown["local"]:
        return format_instant(instant)
    seconds, nanos = divmod(instant, 10**9)
    try:
        local = (_EPOCH + timedelta(seconds=seconds)).astimezone()
    except (OverflowError, ValueError, OSError):  # the time zone has no such time
        return format_instant(instant)
    offset = f"{local:%z}"
    return f"{local:%Y-%m-%dT%H:%M:%S}.{nanos:09d}{offset[:3]}:{offset[3:5]}"
