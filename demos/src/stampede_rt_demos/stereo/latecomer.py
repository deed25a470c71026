"""A second consumer of the pairs. It joins while the demo runs, and the cameras do not notice."""

from __future__ import annotations

import sys

import stampede_rt as st
from stampede_rt_demos.staging.producing import wait_until
from stampede_rt_demos.staging.role import Stage, run_role
from stampede_rt_demos.stereo.matching import ignore, pairs_of, take_pairs
from stampede_rt_demos.stereo.programme import GROUP, Side


def play(stage: Stage) -> dict[str, object]:
    """Join in the middle of the programme and take pairs until its end."""
    with st.connect(stage.settings.address, name="latecomer") as rt:
        start = stage.wait_for_start()
        wait_until(start + stage.settings.length_nanos // 2)
        with pairs_of(rt.group(GROUP), Side.LEFT, payloads=True) as matches:
            account = take_pairs(matches, Side.LEFT, ignore)
    return account.as_record()


if __name__ == "__main__":
    sys.exit(run_role(play))
