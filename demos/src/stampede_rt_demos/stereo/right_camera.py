"""The right camera."""

from __future__ import annotations

import functools
import sys

from stampede_rt_demos.staging.role import run_role
from stampede_rt_demos.stereo.camera import film
from stampede_rt_demos.stereo.programme import Side

if __name__ == "__main__":
    sys.exit(run_role(functools.partial(film, side=Side.RIGHT)))
