"""The plan of the demo: the two cameras, their faults, and the names of the peers. Pure.

Only the seed decides which frames are lost, and how wrong the time of each frame is. So the demo can check the reports
of the consumers.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

from stampede_rt_demos.staging.schedule import LoopedClock

WIDTH, HEIGHT = 320, 180
JPEG_QUALITY = 90
DISPARITY_MIN, DISPARITY_MAX = 4, 24
DISPARITY_CYCLE_FRAMES = 100
JITTER_NANOS = 3_000_000
LOST_SHARE = 0.05
TOLERANCE = "10ms"
SEED = 7
STREAM_MAX_AGE = "10s"
GROUP = "stereo/pair"
DEPTH_CHANNEL = "stereo/depth"
PLANNER, MAPPER = "planner", "mapper"
END_NUMBER = -1
"""The number of the item that each camera puts after its last frame."""
END_DISPARITY = -1
"""The value of the item that the depth consumer puts after its last disparity."""
END_NANOS = 100_000_000
"""The time of these items after the end of the programme: more than the tolerance, so that no frame is a partner."""


class Side(Enum):
    """One of the two cameras; the value is the name of its channel."""

    LEFT = "stereo/left"
    RIGHT = "stereo/right"


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """One frame of one camera. Frames of both cameras with one `number` belong together; `time` is Unix nanoseconds."""

    number: int
    time: int
    is_lost: bool


def planned(side: Side, clock: LoopedClock, start: int, length_nanos: int) -> Iterator[Frame]:
    """Yield the frames of `length_nanos` from `start` on.

    Each time is wrong by the camera's jitter; lost frames are left out.
    """
    rng = random.Random(f"{SEED} {side.value}")
    for number in range(clock.count_before(length_nanos)):
        jitter, is_lost = rng.randint(0, JITTER_NANOS), rng.random() < LOST_SHARE
        yield Frame(number=number, time=start + clock.offset(number) + jitter, is_lost=is_lost)


def without_partner(side: Side, clock: LoopedClock, length_nanos: int) -> list[int]:
    """Return the numbers of the frames that this camera sends and the other one loses."""
    other = Side.RIGHT if side is Side.LEFT else Side.LEFT
    mine, theirs = ([frame.is_lost for frame in planned(one, clock, 0, length_nanos)] for one in (side, other))
    return [number for number, (here, there) in enumerate(zip(mine, theirs, strict=True)) if there and not here]


def true_disparity(number: int) -> int:
    """Return the disparity of a frame in pixels. It changes as if an object came nearer and went away again."""
    phase = number % DISPARITY_CYCLE_FRAMES
    rising = min(phase, DISPARITY_CYCLE_FRAMES - phase)
    return DISPARITY_MIN + rising * (DISPARITY_MAX - DISPARITY_MIN) // (DISPARITY_CYCLE_FRAMES // 2)


def sent(side: Side, clock: LoopedClock, length_nanos: int) -> Sequence[int]:
    """Return the numbers of the frames that a camera sends."""
    return [frame.number for frame in planned(side, clock, 0, length_nanos) if not frame.is_lost]
