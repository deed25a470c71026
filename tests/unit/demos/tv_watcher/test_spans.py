"""The items of a cut event are divided at its captions: every item is in one span, and none in two."""

from types import SimpleNamespace

import pytest

from stampede_rt import ByChannel, Cut, Item, Items
from stampede_rt_demos.tv_watcher.programme import STREAMS, StreamPlan
from stampede_rt_demos.tv_watcher.spans import Span, features_keep_times, spans_of, spans_taken

SECOND, FRAME, BLOCK = 1_000_000_000, 40_000_000, 125_000_000


def item(time: int, duration: int, payload: bytes = b"") -> Item:
    return Item(time, None, duration, 1, payload, {}, "", len(payload), 1)


def event(start: int, seconds: int) -> Span:
    """The items that become visible when the cut advances by this number of captions."""
    end = start + seconds * SECOND
    frames = [item(time, FRAME) for time in range(start, end, FRAME)]
    blocks = [item(time, BLOCK) for time in range(start, end, BLOCK)]
    captions = [item(time, SECOND, b"at %d" % (time // SECOND)) for time in range(start, end, SECOND)]
    return {"captions": captions, "video": frames, "audio": blocks, "motion": list(frames), "loudness": list(blocks)}


def cut(*, behind: str = "", truncated: str = "", late: Item | None = None) -> Cut:
    """The event at six seconds, which brings the caption of second five."""
    channels = {stream.name: channel(stream) for stream in STREAMS}
    items_of = {
        name: Items(
            items,
            interval=None,
            complete=True,
            truncated=name == truncated,
            more=False,
            reason=None,
            incarnation=1,
        )
        for name, items in event(5 * SECOND, 1).items()
    }
    members = list(channels.values())
    return Cut(
        time=6 * SECOND,
        items=ByChannel(members, {channels[name].info.channel_id: items for name, items in items_of.items()}),
        late=ByChannel(members, {channels["motion"].info.channel_id: [late] if late else []}),
        incomplete=[channels[behind]] if behind else [],
    )


def channel(stream: StreamPlan) -> SimpleNamespace:
    """The channel with the fields that a cut event uses."""
    return SimpleNamespace(info=SimpleNamespace(name=stream.channel, channel_id=stream.name.encode()))


def counts(span: Span) -> list[int]:
    return [len(span[name]) for name in ("captions", "video", "audio", "motion", "loudness")]


def test_an_event_with_one_caption_is_one_span_up_to_the_cut():
    found = event(5 * SECOND, 1)
    assert spans_of(found, 6 * SECOND) == [(6 * SECOND, found)]


def test_the_event_of_a_slow_reader_is_divided_at_its_captions():
    spans = spans_of(event(5 * SECOND, 3), 8 * SECOND)
    assert [end for end, _ in spans] == [6 * SECOND, 7 * SECOND, 8 * SECOND]
    assert [span for _, span in spans] == [event(start * SECOND, 1) for start in (5, 6, 7)]


def test_the_cut_at_the_first_caption_brings_no_span():
    assert spans_of(event(0, 0), 5 * SECOND) == []


def test_a_caption_is_over_where_the_cut_is():
    short = {**event(5 * SECOND, 1), "video": [item(5 * SECOND, FRAME)]}
    ((end, span),) = spans_of(short, 5 * SECOND + 2 * FRAME)
    assert (end, counts(span)[:2]) == (5 * SECOND + 2 * FRAME, [1, 1])


def test_a_span_is_reported_by_its_caption_and_its_counts():
    ((step, span),) = spans_taken(cut(), 6 * SECOND + 7)
    assert (step.time, step.end, step.text) == (5 * SECOND, 6 * SECOND, "at 5")
    assert step.counts == {"captions": 1, "video": 25, "audio": 8, "motion": 25, "loudness": 8}
    assert (step.complete, step.features_keep_times, step.received_unix_nano) == (True, True, 6 * SECOND + 7)
    assert counts(span) == list(step.counts.values())


def test_a_span_is_incomplete_if_a_stream_had_not_reached_its_end():
    ((step, _),) = spans_taken(cut(behind="motion"), 9 * SECOND)
    assert not step.complete


def test_a_span_with_collected_items_is_incomplete():
    ((step, _),) = spans_taken(cut(truncated="video"), 9 * SECOND)
    assert not step.complete


def test_a_late_item_is_in_no_span():
    ((step, _),) = spans_taken(cut(late=item(4 * SECOND, FRAME)), 9 * SECOND)
    assert step.counts["motion"] == 25


@pytest.mark.parametrize(
    "motion",
    [
        [],
        [item(time + 1, FRAME) for time in range(0, SECOND, FRAME)],
        [item(time, FRAME - 1) for time in range(0, SECOND, FRAME)],
    ],
    ids=["missing", "another time", "another duration"],
)
def test_features_with_other_times_than_their_sources_are_found(motion):
    assert features_keep_times(event(0, 1))
    assert not features_keep_times({**event(0, 1), "motion": motion})
