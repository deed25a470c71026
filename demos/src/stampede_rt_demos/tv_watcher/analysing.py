"""Turns a stream into a stream of features with the same times. Both analysers use this loop."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping

import stampede_rt as st
from stampede_rt_demos.staging.producing import PUT_TIME_ATTRIBUTE, wait_until
from stampede_rt_demos.staging.receiving import receive
from stampede_rt_demos.staging.role import Stage
from stampede_rt_demos.tv_watcher.opening import open_channel
from stampede_rt_demos.tv_watcher.programme import StreamPlan

Feature = Callable[[bytes], Mapping[str, object]]


def analyse(stage: Stage, source: StreamPlan, target: StreamPlan, feature: Feature) -> dict[str, object]:
    """Put `feature(payload)` as JSON for every item of `source`, with the source's time and duration.

    The features keep the timestamps of their source (paper, section 3.1), so they stay in step with it for every
    reader. After each item the function advances the channel of the features to the end of that item.
    """
    with st.connect(stage.settings.address, name=f"{target.name}-analyser") as rt:
        sources = open_channel(rt, source)
        features = open_channel(rt, target)
        start = stage.wait_for_start()
        analysed = 0

        def handle(item: st.Item) -> None:
            nonlocal analysed
            encoded = json.dumps(feature(item.payload or b"")).encode()
            features.put(
                encoded,
                time=item.time,
                duration=item.duration,
                attributes={PUT_TIME_ATTRIBUTE: str(time.time_ns())},
            )
            end = item.time + (item.duration or 0)
            if end <= time.time_ns():
                features.advance(end)
            analysed += 1
            stage.send_progress(items=analysed)

        end = start + stage.settings.length_nanos
        receipts = receive(sources, start, end, handle)
        wait_until(end)  # like every other span, the last one must be complete when it ends, and not before
        features.advance(end)
        return {"receipts": {source.name: receipts.as_record()}}
