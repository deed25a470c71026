"""The viewer: takes the newest caption as the reference and watches everything that lies in its span, in step.

Nobody tells it how many frames or blocks belong to a caption: the channels do (paper, sections 3.3 and 5).
"""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from typing import NamedTuple

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.receiving import GRACE_SECONDS, receive
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND
from stampede_rt_demos.tv_watcher import steps
from stampede_rt_demos.tv_watcher.opening import open_channel
from stampede_rt_demos.tv_watcher.picture_data import PICTURE_SPANS_MAX, picture_record
from stampede_rt_demos.tv_watcher.programme import CAPTION_NANOS, CAPTIONS, SOURCE_OF_FEATURE, STREAMS
from stampede_rt_demos.tv_watcher.statistics import Step

SPAN_GRACE_SECONDS = 2.0
READ_HERE_ALONE = (CAPTIONS.name, *SOURCE_OF_FEATURE)
Span = Mapping[str, st.Items]


class Lane(NamedTuple):
    """A stream's channel and the one thread that reads it: a thread keeps its own way to a channel's data."""

    channel: st.Channel
    thread: ThreadPoolExecutor


def play(stage: Stage) -> dict[str, object]:
    """Watch until the programme's end.

    The streams that nobody else reads are also received item by item, to know their latency and that nothing is lost.
    """
    with st.connect(stage.settings.address, name="viewer") as rt, ExitStack() as threads:
        channels = {stream.name: open_channel(rt, stream) for stream in STREAMS}
        start = stage.wait_for_start()
        until = start + stage.settings.length_nanos
        live = {
            name: _thread(threads).submit(receive, channels[name], start, until, lambda item: None)
            for name in READ_HERE_ALONE
        }
        lanes = {name: Lane(channel, _thread(threads)) for name, channel in channels.items()}
        spans = _watch(stage, lanes, until)
        receipts = {name: future.result() for name, future in live.items()}
    stage.tell("picture", **picture_record(spans, start))
    return {"receipts": {name: each.as_record() for name, each in receipts.items()}}


def _thread(threads: ExitStack) -> ThreadPoolExecutor:
    return threads.enter_context(ThreadPoolExecutor(1))


def _watch(stage: Stage, lanes: Mapping[str, Lane], until: int) -> deque[Span]:
    """Caption by caption, up to the one that ends at `until`; keeps the last few spans for the picture."""
    spans: deque[Span] = deque(maxlen=PICTURE_SPANS_MAX)
    caption: st.Item | None = None
    while caption is None or caption.time + (caption.duration or 0) < until:
        caption = _next_caption(lanes[CAPTIONS.name].channel, caption, until)
        step, span = _read_span(caption, lanes)
        spans.append(span)
        stage.tell("step", **steps.step_fields(step))
    return spans


def _next_caption(captions: st.Channel, before: st.Item | None, until: int) -> st.Item:
    """The newest caption, once there is a later one than `before`. Raises DemoFailed if none comes."""
    patience = max(0.0, (until - time.time_ns()) / NANOS_PER_SECOND) + GRACE_SECONDS
    caption = captions.newest(after=before, timeout=patience)
    if caption is None:
        raise DemoFailed(f"no caption came for {patience:.0f} s; is the caption producer too slow for this machine?")
    return caption


def _read_span(caption: st.Item, lanes: Mapping[str, Lane]) -> tuple[Step, Span]:
    """Everything that begins in the caption's span, of every stream, when the span is finished.

    All streams are asked at once, the captions too: each answer comes when its own channel has passed the span's end,
    and how far apart they come is the skew.
    """
    start, end = caption.time, caption.time + (caption.duration or CAPTION_NANOS)
    patience = max(0.0, (end - time.time_ns()) / NANOS_PER_SECOND) + SPAN_GRACE_SECONDS
    asked: dict[str, Future[tuple[st.Items, int]]] = {
        name: lane.thread.submit(_read_finished, lane.channel, start, end, patience) for name, lane in lanes.items()
    }
    answers = {name: future.result() for name, future in asked.items()}
    span = {name: items for name, (items, _) in answers.items()}
    step = Step(
        time=start,
        end=end,
        text=(caption.payload or b"").decode(),
        counts={name: len(items) for name, items in span.items()},
        complete=all(items.complete for items in span.values()),
        features_keep_times=features_keep_times(span),
        received_unix_nano={name: received for name, (_, received) in answers.items()},
    )
    return step, span


def _read_finished(channel: st.Channel, start: int, end: int, patience: float) -> tuple[st.Items, int]:
    """The items that begin in `[start, end)`, and when they were in hand; waits for all of them up to `patience` s."""
    items = channel.get(start, end, bounds="[)", match="start", complete=True, timeout=patience)
    return items, time.time_ns()


def features_keep_times(span: Span) -> bool:
    """Every feature has the time and the duration of the item that it was made from, one for one."""
    return all(_times(span[feature]) == _times(span[source]) for feature, source in SOURCE_OF_FEATURE.items())


def _times(items: st.Items) -> list[tuple[int, int | None]]:
    return [(item.time, item.duration) for item in items]


if __name__ == "__main__":
    sys.exit(run_role(play))
