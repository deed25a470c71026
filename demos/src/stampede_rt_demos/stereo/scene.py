"""Makes two views of one clip, a known number of pixels apart, and measures that number. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stampede_rt_demos.stereo.programme import DISPARITY_MAX, WIDTH, Side

WIDE = WIDTH + DISPARITY_MAX
"""The width of the clip's pictures. Both views are cut out of them."""

Picture = NDArray[np.uint8]


def view(wide: Picture, side: Side, disparity: int) -> Picture:
    """Return a camera's view of a picture with WIDE pixels. The right camera is `disparity` pixels further right."""
    first = 0 if side is Side.LEFT else disparity
    return wide[:, first : first + WIDTH]


def measured_disparity(left: Picture, right: Picture) -> int:
    """Return the shift, 0 to DISPARITY_MAX pixels, at which the pictures differ least (mean absolute difference)."""
    a, b = left.astype(np.int16), right.astype(np.int16)
    differences = [np.abs(a[:, shift:] - b[:, : WIDTH - shift]).mean() for shift in range(DISPARITY_MAX + 1)]
    return int(np.argmin(differences))
