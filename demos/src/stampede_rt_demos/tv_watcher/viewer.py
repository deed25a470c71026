"""The viewer: with each caption it gets the items of all streams that the group makes visible together.

It does not know how many frames or blocks belong to a caption; the group decides (paper, sections 3.3 and 5, Figure 7).
"""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.receiving import GRACE_SECONDS, receive
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND
from stampede_rt_demos.tv_watcher import steps
from stampede_rt_demos.tv_watcher.opening import open_channel
from stampede_rt_demos.tv_watcher.picture_data import PICTURE_SPANS_MAX, picture_record
from stampede_rt_demos.tv_watcher.programme import CAPTIONS, GROUP, LOUDNESS, MOTION
from stampede_rt_demos.tv_watcher.spans import Span, spans_taken

MAX_WAIT = "2s"
READ_HERE_ALONE = (CAPTIONS, MOTION, LOUDNESS)


def play(stage: Stage) -> dict[str, object]:
    """Watch until the programme's end.

    The viewer also reads some streams item by item, to measure their latency and losses. These are the streams with no
    other reader.
    """
    with st.connect(stage.settings.address, name="viewer") as rt, ThreadPoolExecutor(len(READ_HERE_ALONE)) as threads:
        channels = {stream.name: open_channel(rt, stream) for stream in READ_HERE_ALONE}
        with rt.group(GROUP).subscribe(max_wait=MAX_WAIT) as cuts:
            start = stage.wait_for_start()
            end = start + stage.settings.length_nanos
            live = {
                name: threads.submit(receive, channel, start, end, lambda item: None)
                for name, channel in channels.items()
            }
            spans = watch(stage, cuts, end)
        receipts = {name: future.result() for name, future in live.items()}
    stage.send_event("picture", **picture_record(spans, start))
    return {"receipts": {name: each.as_record() for name, each in receipts.items()}}


def watch(stage: Stage, cuts: st.CutSubscription, end: int) -> deque[Span]:
    """Read events up to the one whose cut is `end`, and return the last few spans for the picture.

    Raises DemoFailed if this last event has not come GRACE_SECONDS after `end`.
    """
    spans: deque[Span] = deque(maxlen=PICTURE_SPANS_MAX)
    patience = (end - time.time_ns()) / NANOS_PER_SECOND + GRACE_SECONDS
    timer = threading.Timer(max(0.0, patience), cuts.close)
    timer.daemon = True
    timer.start()
    try:
        for cut in cuts:
            for step, span in spans_taken(cut, time.time_ns()):
                spans.append(span)
                stage.send_event("step", **steps.step_fields(step))
            if cut.time >= end:
                return spans
    finally:
        timer.cancel()
    raise DemoFailed(
        f"the group {GROUP} did not come to the programme's end within {GRACE_SECONDS:g} s after it; is the caption "
        "producer too slow for this machine?"
    )


if __name__ == "__main__":
    sys.exit(run_role(play))
