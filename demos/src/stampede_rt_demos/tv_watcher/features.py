"""The measurements of the analysers: motion energy and cuts in the picture, loudness of the sound. Pure."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SILENCE_DBFS = -120.0
CUT_MOTION_MIN = 0.05
CUT_RATIO_MIN = 4.0
RECENT_FRAMES = 12


class Motion(NamedTuple):
    """`energy`: mean absolute change of luma since the frame before, 0 (still) to 1; `cut`: a new scene begins."""

    energy: float
    cut: bool


class Loudness(NamedTuple):
    """Root mean square and peak in dB relative to full scale: a full-scale square wave has 0, a sine -3.01."""

    rms_dbfs: float
    peak_dbfs: float


class MotionMeter:
    """Compares every frame with the one before it. Keeps one frame and the energies of the last few."""

    def __init__(self) -> None:
        self._before: NDArray[np.float32] | None = None
        self._recent: deque[float] = deque(maxlen=RECENT_FRAMES)  # energies of frames that do not begin a scene

    def measure(self, luma: NDArray[np.uint8]) -> Motion:
        """Return the motion in `luma` (height x width, 0 to 255). The first frame has none, and begins no scene.

        Raises ValueError if the shape differs from the shape of the frame before.
        """
        frame = luma.astype(np.float32) / 255.0
        before, self._before = self._before, frame
        if before is None:
            return Motion(0.0, False)
        if before.shape != frame.shape:
            raise ValueError(f"the frame has {frame.shape}, the frame before {before.shape}; the size must not change")
        energy = float(np.abs(frame - before).mean())
        cut = self._is_cut(energy)
        if not cut:
            self._recent.append(energy)
        return Motion(energy, cut)

    def _is_cut(self, energy: float) -> bool:
        """Whether a scene begins: the change is large, and far larger than in the frames before.

        Fast motion is not a cut.
        """
        usual = median(self._recent) if self._recent else 0.0
        return energy >= CUT_MOTION_MIN and energy >= CUT_RATIO_MIN * usual


def loudness(samples: NDArray[np.int16]) -> Loudness:
    """Return the loudness of a block of 16-bit samples. Raises ValueError if the block is empty."""
    if not samples.size:
        raise ValueError("a block without samples has no loudness")
    scaled = samples.astype(np.float64) / 32768.0
    return Loudness(_dbfs(float(np.sqrt(np.mean(scaled**2)))), _dbfs(float(np.abs(scaled).max())))


def envelope(samples: NDArray[np.int16], bins: int) -> list[tuple[float, float]]:
    """Return the lowest and highest sample of each of `bins` equal parts, -1 to 1, for a drawing of the sound."""
    if not 0 < bins <= samples.size:
        raise ValueError(f"{samples.size} samples cannot be drawn in {bins} bins")
    parts = np.array_split(samples.astype(np.float64) / 32768.0, bins)
    return [(float(part.min()), float(part.max())) for part in parts]


def _dbfs(amplitude: float) -> float:
    return max(SILENCE_DBFS, 20 * math.log10(amplitude)) if amplitude > 0 else SILENCE_DBFS
