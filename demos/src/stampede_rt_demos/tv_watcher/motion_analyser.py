"""The motion analyser: measures how much the picture changes, and finds new scenes."""

from __future__ import annotations

import sys

from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.staging.thumbnails import luma_thumbnail
from stampede_rt_demos.tv_watcher.analysing import analyse
from stampede_rt_demos.tv_watcher.features import MotionMeter
from stampede_rt_demos.tv_watcher.programme import MOTION, VIDEO

LUMA_WIDTH = 160
LUMA_HEIGHT = 90


def play(stage: Stage) -> dict[str, object]:
    """Compare every frame with the previous frame."""
    meter = MotionMeter()

    def feature(jpeg: bytes) -> dict[str, object]:
        motion = meter.measure(luma_thumbnail(jpeg, LUMA_WIDTH, LUMA_HEIGHT))
        return {"energy": round(motion.energy, 6), "cut": motion.cut}

    return analyse(stage, VIDEO, MOTION, feature)


if __name__ == "__main__":
    sys.exit(run_role(play))
