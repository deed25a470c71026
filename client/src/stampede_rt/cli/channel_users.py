"""The readers and writers of a channel, as facts of `stampede info`. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from stampede_rt.values.statistics import ChannelStats, ReaderStats, WriterStats
from stampede_rt.values.timeline import format_duration

NOT_KNOWN = "not known: this needs the right to read the channel, and a host of a release that reports them"


def user_facts(stats: ChannelStats, for_people: bool) -> dict[str, Any]:
    """The facts `dropped`, `readers` and `writers`: texts for people, or plain values for programs.

    Lists that the host does not report are None in the plain values.
    """
    if not for_people:
        readers, writers = _plain(stats.readers), _plain(stats.writers)
        return {"dropped": stats.dropped, "readers": readers, "writers": writers}
    return {
        "dropped": stats.dropped,
        "readers": NOT_KNOWN if stats.readers is None else readers_text(stats.readers),
        "writers": NOT_KNOWN if stats.writers is None else writers_text(stats.writers, stats.host_time),
    }


def _plain(users: Sequence[Any] | None) -> list[dict[str, Any]] | None:
    return None if users is None else [asdict(one) for one in users]


def readers_text(readers: Sequence[ReaderStats]) -> str:
    """Readers with the counts of the items that they did not get, such as "dash#3 (5 collected, 1 skipped)"."""
    return ", ".join(one.subscriber + _missed(one) for one in readers) or "none"


def _missed(reader: ReaderStats) -> str:
    counts = (("collected", reader.collected), ("skipped", reader.skipped))
    shown = ", ".join(f"{count} {cause}" for cause, count in counts if count)
    return f" ({shown})" if shown else ""


def writers_text(writers: Sequence[WriterStats], host_time: int) -> str:
    """Writers with the time since their last put, such as "camera-1 (200 ms ago)"."""
    shown = [f"{one.name} ({format_duration(max(0, round(host_time - one.last_put, -6)))} ago)" for one in writers]
    return ", ".join(shown) or "none"
