"""Divides the items of a cut event at the captions. A span has one caption, and all items until the next one. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import stampede_rt as st
from stampede_rt_demos.tv_watcher.programme import CAPTIONS, SOURCE_OF_FEATURE, STREAMS
from stampede_rt_demos.tv_watcher.statistics import StepFigures

Span = Mapping[str, Sequence[st.Item]]
"""Items by stream, of one caption or of a whole cut event."""


def spans_taken(cut: st.Cut[st.Channel], received_unix_nano: int) -> list[tuple[StepFigures, Span]]:
    """Return the spans of a cut event, each with the figures to report.

    Late items are left out: their own span was reported earlier, as incomplete.
    """
    event = {stream.name: cut[stream.channel] for stream in STREAMS}
    complete = not cut.incomplete and not any(items.truncated for items in event.values())
    return [
        (_step(span, end, complete=complete, received_unix_nano=received_unix_nano), span)
        for end, span in spans_of(event, cut.time)
    ]


def spans_of(event: Span, cut: int) -> list[tuple[int, Span]]:
    """Return the spans in one event, each with its end: the next caption, or `cut`.

    As a rule an event has one caption. The event that ends at the first caption has none. An event has several if the
    reader was slower than the captions.
    """
    bounds = [*sorted({caption.time for caption in event[CAPTIONS.name]}), cut]
    return [
        (end, {name: [item for item in items if start <= item.time < end] for name, items in event.items()})
        for start, end in pairwise(bounds)
    ]


def features_keep_times(span: Span) -> bool:
    """Whether every feature has the time and the duration of its source item."""
    return all(_times(span[feature]) == _times(span[source]) for feature, source in SOURCE_OF_FEATURE.items())


def _step(span: Span, end: int, *, complete: bool, received_unix_nano: int) -> StepFigures:
    """Return the viewer's figures for a span: counts, not items."""
    caption = span[CAPTIONS.name][0]
    return StepFigures(
        time=caption.time,
        end=end,
        text=(caption.payload or b"").decode(),
        counts={name: len(items) for name, items in span.items()},
        complete=complete,
        features_keep_times=features_keep_times(span),
        received_unix_nano=received_unix_nano,
    )


def _times(items: Sequence[st.Item]) -> list[tuple[int, int | None]]:
    return [(item.time, item.duration) for item in items]
