"""Motion and loudness, on pictures and sounds whose figures are known beforehand."""

import math

import numpy as np
import pytest

from stampede_rt_demos.tv_watcher.features import SILENCE_DBFS, MotionMeter, envelope, loudness


def picture(brightness: int) -> np.ndarray:
    return np.full((9, 16), brightness, dtype=np.uint8)


def test_the_first_frame_has_no_motion_and_begins_no_scene():
    assert MotionMeter().measure(picture(200)) == (0.0, False)


def test_motion_energy_is_the_mean_change_of_brightness():
    meter = MotionMeter()
    meter.measure(picture(0))
    half = picture(0)
    half[:, :8] = 51
    assert meter.measure(half).energy == pytest.approx(0.1)


def test_a_still_picture_has_no_motion():
    meter = MotionMeter()
    assert [meter.measure(picture(77)).energy for _ in range(5)] == [0.0] * 5


def test_a_sudden_change_after_little_motion_is_a_cut():
    meter = MotionMeter()
    cuts = [meter.measure(picture(level)).cut for level in (10, 11, 12, 13, 100, 101)]
    assert cuts == [False, False, False, False, True, False]


def test_fast_motion_that_goes_on_is_no_cut():
    meter = MotionMeter()
    meter.measure(picture(0))
    meter.measure(picture(12))
    assert not any(meter.measure(picture(level)).cut for level in (27, 42, 57, 72))


def test_two_cuts_close_together_are_both_found():
    meter = MotionMeter()
    assert [meter.measure(picture(level)).cut for level in (0, 1, 90, 200)] == [False, False, True, True]


def test_a_frame_of_another_size_is_refused():
    meter = MotionMeter()
    meter.measure(picture(0))
    with pytest.raises(ValueError, match="size must not change"):
        meter.measure(np.zeros((4, 4), dtype=np.uint8))


def test_silence_has_the_floor_as_its_loudness():
    assert loudness(np.zeros(100, dtype=np.int16)) == (SILENCE_DBFS, SILENCE_DBFS)


def test_a_full_scale_square_wave_has_0_dbfs():
    measured = loudness(np.array([-32768, 32767] * 50, dtype=np.int16))
    assert measured.rms_dbfs == pytest.approx(0, abs=0.001)
    assert measured.peak_dbfs == pytest.approx(0)


def test_a_sine_lies_3_db_below_its_peak_and_a_sine_of_half_the_amplitude_6_db_lower():
    phase = np.linspace(0, 20 * math.pi, 48_000, endpoint=False)
    full = loudness((np.sin(phase) * 32767).astype(np.int16))
    half = loudness((np.sin(phase) * 16383.5).astype(np.int16))
    assert full.rms_dbfs == pytest.approx(-3.01, abs=0.01)
    assert full.rms_dbfs - half.rms_dbfs == pytest.approx(6.02, abs=0.01)


def test_a_block_without_samples_is_refused():
    with pytest.raises(ValueError, match="without samples"):
        loudness(np.zeros(0, dtype=np.int16))


def test_the_envelope_holds_the_extremes_of_each_part():
    samples = np.array([0, 16384, -16384, 0, 0, 0, 8192, 8192], dtype=np.int16)
    assert envelope(samples, 2) == [(-0.5, 0.5), (0.0, 0.25)]


@pytest.mark.parametrize("bins", [0, 9])
def test_an_envelope_of_more_parts_than_samples_is_refused(bins):
    with pytest.raises(ValueError, match="cannot be drawn"):
        envelope(np.zeros(8, dtype=np.int16), bins)
