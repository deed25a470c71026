"""Reads every item of a channel until the end of the programme, and counts it. All readers use this loop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.producing import PUT_TIME_ATTRIBUTE
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND
from stampede_rt_demos.staging.statistics import Receipts

GRACE_SECONDS = 5.0


def receive(channel: st.Channel, start: int, end: int, handle: Callable[[st.Item], None]) -> Receipts:
    """Pass every item from `start` on to `handle`, up to the item whose span ends at `end`.

    Blocks until then. Raises DemoFailed if this last item has not come GRACE_SECONDS after `end`.
    """
    receipts = Receipts()
    with channel.subscribe(start=start) as subscription:
        patience = (end - time.time_ns()) / NANOS_PER_SECOND + GRACE_SECONDS
        watch = threading.Timer(max(0.0, patience), subscription.close)
        watch.daemon = True
        watch.start()
        try:
            for item in subscription:
                receipts.add(
                    seq=item.seq,
                    payload_bytes=len(item.payload or b""),
                    put_unix_nano=int(item.attributes[PUT_TIME_ATTRIBUTE]),
                    received_unix_nano=time.time_ns(),
                )
                handle(item)
                if item.time + (item.duration or 0) >= end:
                    return receipts
        finally:
            watch.cancel()
    raise DemoFailed(
        f"the channel {channel.name} brought {receipts.account.received} items and then nothing more until "
        f"{GRACE_SECONDS:g} s after the programme's end; is its producer too slow for this machine?"
    )
