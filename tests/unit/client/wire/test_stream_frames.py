"""The frames of a stream over a socket, in any pieces in which their bytes arrive."""

from __future__ import annotations

import gc
import sys

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
def test_frames_arrive_as_they_were_sent_wherever_their_bytes_are_cut(
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
        (frame_of(FrameKind.MESSAGE, bytes(301)), "kind 0 has 301 bytes; at most 300 are allowed"),
        (frame_of(FrameKind.END, b"x"), "kind 3 has 1 bytes; at most 0 are allowed"),
        (frame_of(FrameKind.STATUS, b"x"), "kind 2 may not come here"),
        (b"\x00\x00\x00\x00\xff", "kind 255 may not come here"),
    ],
)
def test_a_frame_that_may_not_come_is_refused_at_its_head(frame: bytes, why: str, cut: int) -> None:
    reader, head = FrameReader(LIMITS), frame[:5]
    for begin in range(0, 5 - cut, cut):
        reader.feed(head[begin : begin + cut])
        head_left = head[begin + cut :]
    with pytest.raises(InvalidArgument, match=why):
        reader.feed(head_left if cut < 5 else head)


SHORT_BYTES = 64
SIZES = (0, 1, 4, 59, 60, 63, 64, 65, 123, 128, 129, 300)


def read_in_parts(stream: bytes, parts: list[int]) -> tuple[list[tuple[int, bytes]], FrameReader]:
    """Return the frames that the reader finds, and the reader. `parts`: the most bytes of each read.

    The last number of `parts` holds for all further reads.
    """
    reader, short, found, turn = FrameReader(LIMITS), memoryview(bytearray(SHORT_BYTES)), [], 0
    while stream:
        place = reader.place(short)
        size = min(parts[min(turn, len(parts) - 1)], len(place), len(stream))
        place[:size] = stream[:size]
        found += reader.take(short, size)
        stream, turn = stream[size:], turn + 1
        short[:] = b"?" * SHORT_BYTES  # the reader no longer needs the bytes that it has read
    return found, reader


@pytest.mark.parametrize("long", SIZES)
def test_long_and_short_frames_arrive_as_they_were_sent_wherever_a_read_ends(long: int) -> None:
    sizes = (3, long, 300, long, 0, 7, 200, long)
    frames = [(FrameKind.MESSAGE, bytes([65 + at]) * size) for at, size in enumerate(sizes)]
    stream = b"".join(frame_of(kind, body) for kind, body in frames)
    for cut in range(1, len(stream)):
        found, reader = read_in_parts(stream, [cut, SHORT_BYTES])
        assert found == frames
        assert reader.unfinished_bytes == 0
    for each in (1, 2, 3, 5, 6, 63, 64, 65, 127, 300):
        assert read_in_parts(stream, [each])[0] == frames


def test_the_rest_of_a_long_frame_is_read_into_its_own_memory() -> None:
    reader, short = FrameReader(LIMITS), memoryview(bytearray(SHORT_BYTES))
    frame = frame_of(FrameKind.MESSAGE, b"x" * 200)
    place = reader.place(short)
    assert place is short
    place[:] = frame[:SHORT_BYTES]
    assert reader.take(short, SHORT_BYTES) == []
    for begin in range(SHORT_BYTES, len(frame), 20):  # at first the rest is longer than the short memory, later shorter
        place = reader.place(short)
        assert len(place) == len(frame) - begin
        part = frame[begin : begin + 20]
        place[: len(part)] = part
        found = reader.take(short, len(part))
    assert found == [(FrameKind.MESSAGE, b"x" * 200)]
    assert reader.place(short) is short


@given(lengths=st.lists(st.integers(SHORT_BYTES, 4 * SHORT_BYTES), min_size=2, max_size=6))
def test_later_frames_in_the_same_buffer_do_not_change_earlier_ones(lengths: list[int]) -> None:
    limits = {FrameKind.MESSAGE: 4 * SHORT_BYTES}
    reader, short = FrameReader(limits, kept_bytes_max=3 * SHORT_BYTES), memoryview(bytearray(SHORT_BYTES))
    found: list[tuple[int, bytes]] = []
    bodies = [bytes([turn]) * length for turn, length in enumerate(lengths)]
    for body in bodies:
        left = frame_of(FrameKind.MESSAGE, body)
        while left:
            place = reader.place(short)
            size = min(len(place), len(left), SHORT_BYTES - 1)
            place[:size] = left[:size]
            found += reader.take(short, size)
            left = left[size:]
    assert found == [(FrameKind.MESSAGE, body) for body in bodies]


def test_a_reader_does_not_keep_the_buffer_of_a_frame_longer_than_its_limit() -> None:
    reader, short = FrameReader({FrameKind.MESSAGE: 2**20}, kept_bytes_max=1000), memoryview(bytearray(10))
    frame = frame_of(FrameKind.MESSAGE, bytes(2**20))
    for begin, end in ((0, 10), (10, len(frame))):
        place = reader.place(short)
        place[: end - begin] = frame[begin:end]
        found = reader.take(short, end - begin)
    assert found == [(FrameKind.MESSAGE, bytes(2**20))]
    assert sum(sys.getsizeof(kept) for kept in gc.get_referents(reader) if isinstance(kept, bytearray)) < 1000


def test_a_reader_keeps_only_the_arrived_bytes_of_an_unfinished_frame() -> None:
    reader = FrameReader({FrameKind.MESSAGE: 2**30})
    reader.feed(frame_of(FrameKind.MESSAGE, b"a" * 10) + frame_of(FrameKind.MESSAGE, bytes(2**16))[:105])
    assert reader.unfinished_bytes == 105


@given(body=st.binary(min_size=1, max_size=300), begun=st.integers(5, 304), cuts=st.lists(st.integers(1, 100)))
def test_the_rest_of_a_frame_may_be_written_into_its_buffer(body: bytes, begun: int, cuts: list[int]) -> None:
    whole, reader, turn = frame_of(FrameKind.MESSAGE, body), FrameReader(LIMITS), 0
    begun = min(begun, len(whole) - 1)
    assert reader.feed(whole[:begun]) == []
    found: list[tuple[int, bytes]] = []
    while rest := whole[reader.unfinished_bytes :]:
        assert reader.missing_bytes == len(rest)
        buffer = reader.buffer()
        size = min(len(buffer), [*cuts, 300][min(turn, len(cuts))])
        buffer[:size] = rest[:size]
        turn += 1
        if found := reader.filled(size):
            break
    assert found == [(FrameKind.MESSAGE, body)]
    assert (reader.unfinished_bytes, reader.missing_bytes) == (0, 0)
    assert reader.feed(whole) == found


def test_the_body_of_a_long_frame_can_be_a_view_of_a_given_buffer() -> None:
    buffers = [bytearray(400), bytearray(400)]
    reader = FrameReader(LIMITS, new_buffer=lambda frame_bytes: buffers[frame_bytes % 2])
    for body in (b"a" * 300, b"b" * 200, b"c" * 299):
        whole = frame_of(FrameKind.MESSAGE, body)
        assert reader.feed(whole[:7]) == []
        reader.buffer()[:90] = whole[7:97]
        assert reader.filled_buffer(90) is None
        reader.buffer()[:] = whole[97:]
        frame = reader.filled_buffer(len(whole) - 97)
        assert frame is not None
        assert (frame[0], bytes(frame[1])) == (FrameKind.MESSAGE, body)
        assert frame[1].obj is buffers[len(whole) % 2]
        assert reader.unfinished_bytes == 0
