"""How `stampede bench paper --figure skew` compares the items of two consumers."""

from __future__ import annotations

from contextlib import nullcontext

import pytest

from stampede_rt_bench.paper.captioned_video import (
    FRAME_NANOS,
    FRAMES_PER_CAPTION,
    MACHINES,
    NANOS_PER_MS,
    NANOS_PER_SECOND,
    Receipt,
    Setting,
    play,
)
from stampede_rt_bench.paper.skew import judge
from stampede_rt_local.namespaces import NamespaceNetwork, unavailable_because

CAPTION_NANOS = NANOS_PER_SECOND // 2
CAPTIONS = [Receipt(number * CAPTION_NANOS, number * CAPTION_NANOS + 10) for number in range(3)]


def frames(count: int, late: dict[int, int] | None = None) -> list[Receipt]:
    """Frames with their captions. The frames in `late` come later than their captions, by the stated milliseconds."""
    delays = late or {}
    times = [number * NANOS_PER_SECOND // 30 for number in range(count)]
    return [
        Receipt(at, CAPTIONS[number // FRAMES_PER_CAPTION].received + delays.get(number, 0) * NANOS_PER_MS)
        for number, at in enumerate(times)
    ]


def test_frames_read_with_their_caption_have_no_skew() -> None:
    run = judge(frames(31), CAPTIONS)
    assert run.skew_ms == 0
    assert run.frames_together == [15, 15]


def test_the_skew_of_a_run_is_the_root_of_the_mean_square_of_its_frames() -> None:
    run = judge(frames(31, late={14: 30}), CAPTIONS)
    assert run.skew_ms == pytest.approx(30 / 30**0.5)
    assert run.frames_together == [14, 15]
    assert [place for place, ms in run.skews_ms if ms] == [14]


def test_captions_that_begin_between_two_frames_also_have_frames_in_each_place() -> None:
    late = [Receipt(caption.time + FRAME_NANOS // 2, caption.received) for caption in CAPTIONS]
    run = judge(frames(40), late)
    assert [place for place, _ in run.skews_ms] == [*range(15), *range(15)]


def test_a_run_that_misses_frames_is_refused() -> None:
    with pytest.raises(AssertionError, match=r"3 captions came\. These have not 15 frames each: \[1\]"):
        judge(frames(29), CAPTIONS)


def test_consumers_in_separate_namespaces_get_every_frame_through_the_group() -> None:
    with nullcontext() if unavailable_because() else NamespaceNetwork(MACHINES) as network:
        frames, captions = play(Setting(name="grouped"), network, seconds=1)
    assert [frame.time - frames[0].time for frame in frames] == [n * NANOS_PER_SECOND // 30 for n in range(30)]
    assert [caption.time for caption in captions] == [frames[0].time, frames[15].time]
    assert len({frame.received for frame in frames}) < len(frames), "some frames came together"
