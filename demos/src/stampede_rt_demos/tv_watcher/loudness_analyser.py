"""The loudness analyser: measures the loudness of every block of sound."""

from __future__ import annotations

import sys

import numpy as np

from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.tv_watcher.analysing import analyse
from stampede_rt_demos.tv_watcher.features import loudness
from stampede_rt_demos.tv_watcher.programme import AUDIO, LOUDNESS


def feature(pcm: bytes) -> dict[str, object]:
    """Return the loudness of a block of 16-bit little-endian samples."""
    measured = loudness(np.frombuffer(pcm, dtype="<i2"))
    return {"rms_dbfs": round(measured.rms_dbfs, 2), "peak_dbfs": round(measured.peak_dbfs, 2)}


def play(stage: Stage) -> dict[str, object]:
    """Measure every block."""
    return analyse(stage, AUDIO, LOUDNESS, feature)


if __name__ == "__main__":
    sys.exit(run_role(play))
