"""Names and indexes of segments in object stores."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_channel_host.core.archive import HEAD_BYTES, BlockHead, PlacedBlock, Segment
from stampede_rt_channel_host.core.archive.stored_segment import (
    decode_index,
    encode_index,
    first_number,
    object_name,
    segment_named,
)

times, seqs = st.integers(-(2**63), 2**63 - 1), st.integers(1, 2**63)


@st.composite
def segments(draw: st.DrawFn) -> Segment:
    first, end = sorted((draw(seqs), draw(seqs)))
    keys = sorted((draw(times), draw(seqs)) for _ in range(2))
    items = draw(st.integers(0, 2**40))
    low, high = keys if items else (None, None)
    number = first_number(draw(st.integers(0, 2**63))) + draw(st.integers(0, 10**6))
    return Segment(number, draw(st.integers(0, 2**40)), items, first, end, low, high, draw(times))


@given(segments())
def test_the_name_of_an_object_names_its_segment(segment: Segment) -> None:
    name = object_name(segment)
    assert segment_named(name) == segment
    assert len(name) < 255  # a store in a folder uses the name as a file name


@given(st.text(max_size=40), segments())
def test_an_object_with_another_name_is_no_segment(text: str, segment: Segment) -> None:
    assert segment_named(text) is None
    assert segment_named("0" + object_name(segment)) is None
    assert segment_named(object_name(segment) + "~") is None


def test_a_name_with_impossible_numbers_is_no_segment() -> None:
    good = "000003000000001_900_2_1_3_10.1_11.2_12.segment"
    assert segment_named("000" + good) is not None
    for bad in ("_900_2_3_1_10.1_11.2", "_900_2_1_3_x_11.2", "_900_2_1_3_11.2_10.1", "_900_0_1_3_10.1_11.2"):
        assert segment_named(f"000000003000000001{bad}_12.segment") is None


def blocks(count: int) -> list[PlacedBlock]:
    heads = [BlockHead(1, 5, 20, 1, 2, n, n + 1, (n, n), (n, n), n, n) for n in range(1, count + 1)]
    return [PlacedBlock(at * (HEAD_BYTES + 20), head) for at, head in enumerate(heads)]


def test_the_index_of_a_segment_has_its_blocks_and_any_changed_byte_is_noticed() -> None:
    found, length = blocks(3), 3 * (HEAD_BYTES + 20)
    raw = encode_index(found)
    assert decode_index(raw, length) == found
    assert decode_index(raw, length - 1) is None  # the object is truncated
    for at in range(len(raw)):
        assert decode_index(raw[:at] + bytes([raw[at] ^ 4]) + raw[at + 1 :], length) is None
        assert decode_index(raw[:at], length) is None
