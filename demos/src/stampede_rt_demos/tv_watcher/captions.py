"""The captions, which describe the clip second by second. Pure.

The descriptions were written for this clip from its frames. The clip is looped, and its length is not a whole number of
seconds. So each caption is chosen by the position in the clip at which it begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stampede_rt_demos.staging.schedule import PlannedItem


@dataclass(frozen=True, slots=True)
class Scene:
    """From `start_nanos` of the clip on, `text` describes the picture."""

    start_nanos: int
    text: str


SCENES = (
    Scene(0, "A big grey rabbit crawls out of his burrow"),
    Scene(1_000_000_000, "One hand on the rock, he pushes himself up"),
    Scene(1_700_000_000, "He rises and lifts both arms"),
    Scene(2_400_000_000, "He stretches, arms wide, eyes shut"),
    Scene(3_000_000_000, "A long, wide yawn"),
    Scene(4_200_000_000, "He lets his arm sink"),
    Scene(4_480_000_000, "Still sleepy, he puts a hand to his face"),
)
LOOP_NOTE = "the clip starts again"


def caption_text(clip_nanos: int, loop_nanos: int, caption_nanos: int) -> str:
    """Return the timecode, and the scene that fills most of `[clip_nanos, clip_nanos + caption_nanos)`."""
    loops_inside = clip_nanos < loop_nanos < clip_nanos + caption_nanos
    scene = max(SCENES, key=lambda scene: _overlap_nanos(scene, clip_nanos, loop_nanos, caption_nanos))
    note = f" ({LOOP_NOTE})" if loops_inside else ""
    return f"{timecode(clip_nanos)} {scene.text}{note}"


def timecode(clip_nanos: int) -> str:
    """Return minutes, seconds and hundredths within the clip, such as "00:03.28"."""
    seconds, hundredths = divmod(clip_nanos // 10_000_000, 100)
    return f"{seconds // 60:02d}:{seconds % 60:02d}.{hundredths:02d}"


def planned_captions(loop_nanos: int, caption_nanos: int, start: int, length_nanos: int) -> Iterator[PlannedItem]:
    """Yield the captions of `length_nanos` from `start` on. Each is due when it begins."""
    for n in range(length_nanos // caption_nanos):
        clip_nanos = n * caption_nanos % loop_nanos
        time = start + n * caption_nanos
        text = caption_text(clip_nanos, loop_nanos, caption_nanos)
        yield PlannedItem(time=time, duration=caption_nanos, due=time, payload=text.encode(), clip_nanos=clip_nanos)


def _overlap_nanos(scene: Scene, clip_nanos: int, loop_nanos: int, caption_nanos: int) -> int:
    later = [other.start_nanos for other in SCENES if other.start_nanos > scene.start_nanos]
    scene_end = min([*later, loop_nanos])
    shared = 0
    for shift in (0, loop_nanos):  # the second shift is for the part of the caption in the next loop
        start = max(clip_nanos, scene.start_nanos + shift)
        shared += max(0, min(clip_nanos + caption_nanos, scene_end + shift) - start)
    return shared
