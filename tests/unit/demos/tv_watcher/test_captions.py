"""A caption describes the pictures that the clip has at the time of the caption."""

from stampede_rt_demos.tv_watcher.captions import SCENES, caption_text, planned_captions, timecode

SECOND = 1_000_000_000
LOOP = 5_280_000_000


def test_a_caption_names_the_scene_that_fills_most_of_its_second():
    assert caption_text(0, LOOP, SECOND) == f"00:00.00 {SCENES[0].text}"
    assert caption_text(1_100_000_000, LOOP, SECOND) == f"00:01.10 {SCENES[1].text}"
    assert caption_text(3 * SECOND, LOOP, SECOND) == f"00:03.00 {SCENES[4].text}"


def test_a_caption_beyond_the_end_of_the_clip_says_so_and_names_the_longer_scene():
    assert caption_text(4_440_000_000, LOOP, SECOND) == f"00:04.44 {SCENES[-1].text} (the clip starts again)"
    assert caption_text(5 * SECOND, LOOP, SECOND) == f"00:05.00 {SCENES[0].text} (the clip starts again)"


def test_a_caption_that_ends_with_the_clip_does_not_mention_the_next_run_of_the_clip():
    assert "again" not in caption_text(LOOP - SECOND, LOOP, SECOND)


def test_captions_adjoin_and_follow_the_clip_when_it_starts_again():
    plan = list(planned_captions(LOOP, SECOND, 100, 7 * SECOND))
    assert [caption.time for caption in plan] == [100 + n * SECOND for n in range(7)]
    assert {caption.duration for caption in plan} == {SECOND}
    assert [caption.clip_nanos for caption in plan][-2:] == [5 * SECOND, 720_000_000]
    assert plan[-1].payload.decode().startswith("00:00.72 ")


def test_timecodes_are_minutes_seconds_and_hundredths():
    assert [timecode(nanos) for nanos in (0, 3_289_999_999, 61 * SECOND)] == ["00:00.00", "00:03.28", "01:01.00"]


def test_the_scenes_are_in_order_and_begin_with_the_clip():
    starts = [scene.start_nanos for scene in SCENES]
    assert starts[0] == 0
    assert starts == sorted(set(starts))
