from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt.errors import InvalidArgument
from stampede_rt.wire.stream_frames import FrameKind, FrameReader, frame_of

LIMITS = {FrameKind.MESSAGE: 300, FrameKind.OPENING: 20, FrameKind.END: 0}
FRAMES = st.lists(
    st.tuples(st.just(FrameKind.MESSAGE), st.binary(max_size=300)) | st.tuples(st.just(FrameKind.END), st.just(b"")),
    max_size=8,
)


@given(frames=FRAMES, cuts=st.lists(st.integers(1, 400), min_size=1))
def test_frames_come_as_they_were_sent_however_their_bytes_are_cut(
    frames: list[tuple[FrameKind, bytes]], cuts: list[int]
) -> None:
    stream, reader = b"".join(frame_of(kind, body) for kind, body in frames), FrameReader(LIMITS)
    found, turn = [], 0
    while stream:
        size = cuts[turn % len(cuts)]
        found += reader.feed(stream[:size])
        stream, turn = stream[size:], turn + 1
    assert found == frames
    assert reader.unfinished_bytes == 0


@pytest.mark.parametrize("cut", [1, 4, 5, 6, 100])
@pytest.mark.parametrize(
    ("frame", "why"),
    [
        (frame_of(FrameKind.MESSAGE, bytes(301)), "kind 0 came, of 301 bytes; it has at most 300"),
        (frame_of(FrameKind.END, b"x"), "kind 3 came, of 1 bytes; it has at most 0"),
        (frame_of(FrameKind.STATUS, b"x"), "kind 2 came, which may not come here"),
        (b"\x00\x00\x00\x00\xff", "kind 255 came, which may not come here"),
    ],
)
def test_a_frame_that_may_not_come_is_refused_at_its_head(frame: bytes, why: str, cut: int) -> None:
    reader, head = FrameReader(LIMITS), frame[:5]
    for begin in range(0, 5 - cut, cut):
        reader.feed(head[begin : begin + cut])
        head_left = head[begin + cut :]
    with pytest.raises(InvalidArgument, match=why):
        reader.feed(head_left if cut < 5 else head)


def test_only_the_bytes_that_came_of_an_unfinished_frame_are_kept() -> None:
    reader = FrameReader({FrameKind.MESSAGE: 2**30})
    reader.feed(frame_of(FrameKind.MESSAGE, b"a" * 10) + frame_of(FrameKind.MESSAGE, bytes(2**16))[:105])
    assert reader.unfinished_bytes == 105


@given(body=st.binary(min_size=1, max_size=300), begun=st.integers(5, 304), cuts=st.lists(st.integers(1, 100)))
def test_the_rest_of_a_frame_may_be_written_to_its_room(body: bytes, begun: int, cuts: list[int]) -> None:
    whole, reader, turn = frame_of(FrameKind.MESSAGE, body), FrameReader(LIMITS), 0
    begun = min(begun, len(whole) - 1)
    assert reader.feed(whole[:begun]) == []
    found: list[tuple[int, bytes]] = []
    while rest := whole[reader.unfinished_bytes :]:
        assert reader.missing_bytes == len(rest)
        room = reader.room()
        size = min(len(room), [*cuts, 300][min(turn, len(cuts))])
        room[:size] = rest[:size]
        turn += 1
        if found := reader.filled(size):
            break
    assert found == [(FrameKind.MESSAGE, body)]
    assert (reader.unfinished_bytes, reader.missing_bytes) == (0, 0)
    assert reader.feed(whole) == found
