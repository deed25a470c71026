"""The stereo demo's plan, its views and their disparity, and the text of its report."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND, LoopedClock
from stampede_rt_demos.stereo.programme import (
    DISPARITY_MAX,
    DISPARITY_MIN,
    JITTER_NANOS,
    Side,
    planned,
    sent,
    true_disparity,
    without_partner,
)
from stampede_rt_demos.stereo.report import StereoReport, render, subtitle
from stampede_rt_demos.stereo.scene import WIDE, measured_disparity, view

CLOCK = LoopedClock([number * 40_000_000 for number in range(125)], 5 * NANOS_PER_SECOND)
LENGTH = 20 * NANOS_PER_SECOND


def test_each_camera_loses_frames_of_its_own_and_jitters_within_its_bound() -> None:
    left, right = (list(planned(side, CLOCK, 1000, LENGTH)) for side in Side)
    assert len(left) == len(right) == 500
    assert [frame.is_lost for frame in left] != [frame.is_lost for frame in right]
    assert all(0 <= frame.time - 1000 - CLOCK.offset(frame.number) <= JITTER_NANOS for frame in left + right)


def test_a_frame_without_a_partner_is_one_that_only_one_camera_sends() -> None:
    left, right = (set(sent(side, CLOCK, LENGTH)) for side in Side)
    assert set(without_partner(Side.LEFT, CLOCK, LENGTH)) == left - right
    assert set(without_partner(Side.RIGHT, CLOCK, LENGTH)) == right - left
    assert left - right
    assert right - left


def test_the_disparity_rises_and_falls_between_its_bounds() -> None:
    disparities = [true_disparity(number) for number in range(200)]
    assert (min(disparities), max(disparities)) == (DISPARITY_MIN, DISPARITY_MAX)
    assert max(abs(a - b) for a, b in itertools.pairwise(disparities)) <= 1


@pytest.mark.parametrize("disparity", [0, DISPARITY_MIN, 13, DISPARITY_MAX])
def test_the_disparity_of_two_views_is_found_again(disparity: int) -> None:
    wide = np.random.default_rng(1).integers(0, 255, (40, WIDE), dtype=np.uint8)
    assert measured_disparity(view(wide, Side.LEFT, disparity), view(wide, Side.RIGHT, disparity)) == disparity


REPORT = StereoReport(
    seconds=4,
    sent={Side.LEFT: 95, Side.RIGHT: 96},
    pairs_possible=90,
    pairs=90,
    wrong=0,
    alone_expected={Side.LEFT: [3, 8], Side.RIGHT: [5]},
    alone_reported={Side.LEFT: [8, 3], Side.RIGHT: [5]},
    dropped=0,
    measured=[(0, 4, 4), (1, 6, 4)],
    latecomer_pairs=40,
    put_p50_nanos={Side.LEFT: (1_000_000, 1_200_000), Side.RIGHT: (None, None)},
    answers=10,
    unanswered=1,
    stops=3,
    round_trip_p50_nanos=5_000_000,
)


def test_the_report_counts_paired_frames_and_names_every_unpaired_frame() -> None:
    text = render(REPORT)
    assert "90 of 90" in text
    assert "exactly these" in text
    assert "NOT" not in text
    assert "1 of 2 pairs" in text
    assert "asked 11 times and got 10 answers" in text
    assert "90 of 90 pairs, 0 wrong" in subtitle(REPORT)


def test_a_frame_that_was_not_announced_is_not_skipped() -> None:
    forgetful = dataclasses.replace(REPORT, alone_reported={Side.LEFT: [8], Side.RIGHT: [5]})
    assert not forgetful.told_of_all
    assert "NOT exactly these" in render(forgetful)
