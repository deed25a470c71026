"""Replays a recording into the ApproximateTimeSynchronizer of ROS message_filters, in the system's Python.

Debian's package python3-message-filters has it. It needs no ROS installation, and sends nothing.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from stampede_rt_bench.matching.recording import RATES_HZ, REFERENCE, Arrival
from stampede_rt_bench.matching.sets import FoundSet, Replay

SYSTEM_PYTHON = Path("/usr/bin/python3")
QUEUE_ITEMS = 50
PACKAGE = "python3-message-filters"
RUN_SECONDS_MAX = 300

# This script runs in the system's Python, which has message_filters but not this package. So besides message_filters it
# uses only the standard library.
SCRIPT = """
import json, sys
import rospy
from message_filters import ApproximateTimeSynchronizer, SimpleFilter

job = json.load(sys.stdin)
rospy.rostime.set_rostime_initialized(True)
now = 0
found = []

class Message:
    def __init__(self, time):
        self.time = time
        self.header = type("Header", (), {"stamp": rospy.Time(time // 10**9, time % 10**9)})

filters = {stream: SimpleFilter() for stream in job["streams"]}
synchroniser = ApproximateTimeSynchronizer(list(filters.values()), job["queue_items"], job["slop_s"])
synchroniser.registerCallback(lambda *messages: found.append([now] + [one.time for one in messages]))
for arrived, stream, time in job["arrivals"]:
    now = arrived
    rospy.rostime._set_rostime(rospy.Time(arrived // 10**9, arrived % 10**9))
    filters[stream].signalMessage(Message(time))
json.dump(found, sys.stdout)
"""


@cache
def is_installed() -> bool:
    """Whether the system's Python has message_filters."""
    if not SYSTEM_PYTHON.exists():
        return False
    probe = [str(SYSTEM_PYTHON), "-c", "import message_filters"]
    return subprocess.run(probe, capture_output=True, timeout=RUN_SECONDS_MAX, check=False).returncode == 0


def replay(arrivals: Sequence[Arrival], tolerance_nanos: int) -> Replay:
    """Return the sets that the synchroniser gives to its callback for this recording, with their times.

    `tolerance_nanos` becomes the synchroniser's `slop`.
    """
    streams = list(RATES_HZ)
    job = {
        "streams": streams,
        "queue_items": QUEUE_ITEMS,
        "slop_s": tolerance_nanos / 1e9,
        "arrivals": [tuple(arrival) for arrival in arrivals],
    }
    command = [str(SYSTEM_PYTHON), "-c", SCRIPT]
    ran = subprocess.run(
        command, input=json.dumps(job), capture_output=True, text=True, timeout=RUN_SECONDS_MAX, check=True
    )
    sets = []
    for given, *times in json.loads(ran.stdout):
        by_stream = dict(zip(streams, times, strict=True))
        sets.append(FoundSet(given=given, reference=by_stream.pop(REFERENCE), times=by_stream))
    return Replay(sets=sets, reported_unmatched=None)
