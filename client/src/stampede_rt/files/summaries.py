"""The summary of a recording, as a metadata record of its file. Pure."""

from __future__ import annotations

import json
from typing import Any

from stampede_rt.errors import FileError
from stampede_rt.files.json_text import read_json
from stampede_rt.values.recording import RecordedCounts, RecordingSummary

SUMMARY_NAME = "stampede.summary"  # the name of the metadata record


def summary_fields(summary: RecordingSummary) -> dict[str, str]:
    """Return the metadata that keeps a summary."""
    channels = json.dumps([one.to_json() for one in summary.channels], ensure_ascii=False, separators=(",", ":"))
    fields = {"version": "1", "channels": channels, "absent": json.dumps(list(summary.absent))}
    return fields | ({"damaged": json.dumps(list(summary.damaged))} if summary.damaged else {})


def summary_of(path: str, values: dict[str, str]) -> RecordingSummary:
    """Return the summary in a metadata record. Raises FileError if it is damaged."""
    try:
        channels: list[Any] = read_json(values["channels"])
        absent, damaged = (
            tuple(str(one) for one in read_json(values.get(name, "[]"))) for name in ("absent", "damaged")
        )
        found = tuple(RecordedCounts.from_json(one) for one in channels)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileError(f"the summary of the file {path!r} is damaged: {error}") from error
    return RecordingSummary(path=path, channels=found, absent=absent, damaged=damaged)
