"""The archive of a channel, as facts of `stampede info`. Pure."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from stampede_rt.cli.instants import instant_text
from stampede_rt.cli.output import bytes_text, number_of
from stampede_rt.values.statistics import ArchiveStats, ChannelStats


def archive_facts(stats: ChannelStats, for_people: bool) -> dict[str, Any]:
    """The fact `archive`, and for people `archive_place`, too. Texts for people, or plain values for programs.

    A channel that is not recorded has the text "none", or None.
    """
    if not for_people:
        return {"archive": None if stats.archive is None else asdict(stats.archive)}
    if stats.archive is None:
        return {"archive": "none"}
    return {"archive": _text(stats.archive), "archive_place": stats.archive.place}


def _text(archive: ArchiveStats) -> str:
    parts = [f"{number_of(archive.items, 'item')} ({bytes_text(archive.bytes)})"]
    if archive.bytes > archive.disk_bytes:
        parts.append(f"{bytes_text(archive.disk_bytes)} of it on the host's disk")
    if archive.oldest is not None and archive.newest is not None:
        parts.append(f"from {instant_text(archive.oldest)} to {instant_text(archive.newest)}")
    if archive.waiting:
        parts.append(f"{number_of(archive.waiting, 'item')} not on the disk yet")
    if archive.unarchived:
        parts.append(f"{number_of(archive.unarchived, 'item')} collected by max_bytes before the disk had them")
    if archive.failure:
        parts.append(f"fails: {archive.failure}")
    return ", ".join(parts)
