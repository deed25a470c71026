"""The plan of the rover demo: who takes part, and when the hosts are drained and killed. Pure."""

from __future__ import annotations

RIG = "rig"
"""The rover's own process: a host with the channels of both cameras, and a peer with a mailbox."""
SECONDS_MIN = 16
"""The loss of a host stops its channels until its lease ends, after about 6 s. The run must go on long enough after
that."""
STREAM_MAX_AGE = "60s"
DEPTH_SECONDS_MAX = 100.0
"""The longest time from the last frame to the last disparity. A busy machine measures late."""

PLANNER_JOINS = 0.2
DRAIN = 0.3
KILL = 0.45
"""The moments of the run, as shares of its length."""

EVERY = 3
"""The rover's cameras take every third frame of the film, so that they catch up soon after the outage."""


def is_taken(number: int) -> bool:
    """Whether the rover's cameras take the frame of this number."""
    return number % EVERY == 0
