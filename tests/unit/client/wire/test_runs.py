"""Item runs: a reader decodes the items that a producer encoded, whatever the host appends or cuts."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from google.protobuf.message import DecodeError
from hypothesis import given, settings, strategies

from stampede_rt.errors import ItemTooLarge, MalformedRun
from stampede_rt.v1 import item_pb2
from stampede_rt.wire import runs
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.run_slices import sealed_columns, sealed_parts, slice_run
from stampede_rt.wire.runs import ITEM_BYTES_MAX, RUN_BYTES_MAX, encode_run, parse_run, seal_run, select_items

items = strategies.lists(
    strategies.tuples(strategies.integers(0, 50), strategies.integers(-1, 20), strategies.binary(max_size=20)),
    min_size=1,
    max_size=12,
)
decoder = ItemDecoder(incarnation=7, content_type="text/plain", payloads=True)


def delivered(sealed: bytes, next_time: int | None = None) -> item_pb2.DeliveredRun:
    return item_pb2.DeliveredRun(run=item_pb2.ItemRun.FromString(sealed), next_time_unix_nano=next_time)


def encoded(columns: list[tuple[int, int, bytes]], **rest: object) -> bytes:
    times, durations, payloads = zip(*columns, strict=True)
    return encode_run(payloads, times=times, durations=durations, **rest)  # type: ignore[arg-type]


@given(items, strategies.integers(0, 2**63))
def test_every_decoded_column_is_as_it_was_encoded(columns: list[tuple[int, int, bytes]], first_seq: int) -> None:
    sealed = seal_run(encoded(columns, attributes={"k": "v"}), first_seq)
    found = decoder.decode([delivered(sealed)])
    assert [(item.time, -1 if item.duration is None else item.duration, item.payload) for item in found] == columns
    assert [item.seq for item in found] == list(range(first_seq, first_seq + len(columns)))
    assert {item.content_type for item in found} == {"text/plain"}
    assert found[0].attributes == {"k": "v"}


@given(
    items,
    strategies.integers(1, 2**63),
    strategies.booleans(),
    strategies.sampled_from([{}, {"k": "v"}]),
    strategies.data(),
)
def test_the_parts_of_a_sealed_run_are_the_parts_that_a_parser_finds(
    columns: list[tuple[int, int, bytes]], first_seq: int, stamped: bool, attributes: dict[str, str],
    data: strategies.DataObject,
) -> None:  # fmt: skip
    _, durations, payloads = zip(*columns, strict=True)
    times = [7] * len(columns)
    raw = encode_run(payloads, times=None if stamped else times, durations=durations, attributes=attributes)
    sealed = seal_run(raw, first_seq, times if stamped else None)
    parts = sealed_parts(sealed)
    assert parts is not None
    assert sealed[parts.payloads] == b"".join(payloads)
    assert dict(item_pb2.ItemRun.FromString(parts.labels).attributes) == attributes
    found = parts.columns
    parsed = item_pb2.ItemRun.FromString(sealed)
    assert (found.first_seq, [*found.times]) == (parsed.first_seq, [*parsed.time_unix_nano])
    assert [*(found.durations or ())] == [*parsed.duration_nanos]
    assert [*found.lengths] == [*parsed.payload_length_bytes]
    assert sealed_columns(sealed[: data.draw(strategies.integers(0, len(sealed) - 1))]) is None


@pytest.mark.parametrize("attributes", [{}, {"k": "v"}])
def test_a_damaged_run_has_no_columns_or_the_columns_that_a_parser_finds(attributes: dict[str, str]) -> None:
    sealed, compared = seal_run(encoded([(1, 2, b"abc"), (3, 4, b"de")], attributes=attributes), 5), 0
    for at in range(len(sealed)):
        for flipped in range(1, 256):
            raw = sealed[:at] + bytes((sealed[at] ^ flipped,)) + sealed[at + 1 :]
            found = sealed_columns(raw)
            if found is not None and item_parses(raw):
                compared += 1
                parsed = item_pb2.ItemRun.FromString(raw)
                assert [*found.lengths] == [*parsed.payload_length_bytes]
                assert (found.first_seq, [*found.times]) == (parsed.first_seq, [*parsed.time_unix_nano])
    assert compared > 255 * 8


def item_parses(raw: bytes) -> bool:
    try:
        item_pb2.ItemRun.FromString(raw)
    except DecodeError:
        return False
    return True


@given(items, strategies.data())
def test_a_slice_is_the_same_items(columns: list[tuple[int, int, bytes]], data: strategies.DataObject) -> None:
    sealed = seal_run(encoded(columns), 5)
    lo = data.draw(strategies.integers(0, len(columns) - 1))
    hi = data.draw(strategies.integers(lo + 1, len(columns)))
    (whole,) = decoder.decode_each([delivered(sealed)])
    (cut,) = decoder.decode_each([delivered(slice_run(sealed, lo, hi))])
    assert [(item.time, item.seq, item.payload) for item in cut] == [
        (item.time, item.seq, item.payload) for item in whole[lo:hi]
    ]
    bare = item_pb2.ItemRun.FromString(slice_run(sealed, lo, hi, without_payloads=True))
    assert (bare.payloads, list(bare.payload_length_bytes)) == (b"", [len(p) for _, _, p in columns[lo:hi]])


@given(items, strategies.data())
def test_the_rest_of_a_run_keeps_its_order(columns: list[tuple[int, int, bytes]], data: strategies.DataObject) -> None:
    kept = sorted(data.draw(strategies.sets(strategies.integers(0, len(columns) - 1), min_size=1)))
    rest = parse_run(select_items(encoded(columns), kept))
    assert list(rest.times or ()) == [columns[i][0] for i in kept]
    assert list(rest.lengths) == [len(columns[i][2]) for i in kept]


def test_a_host_stamps_a_run_that_has_no_times() -> None:
    raw = encode_run([b"a", b"bc"], times=None)
    assert parse_run(raw).times is None
    found = decoder.decode([delivered(seal_run(raw, 3, [9, 9]))])
    assert [(item.time, item.payload) for item in found] == [(9, b"a"), (9, b"bc")]


def test_an_end_is_the_earlier_of_its_duration_and_the_next_bucket() -> None:
    sealed = seal_run(encoded([(0, 5, b""), (0, -1, b""), (10, 100, b""), (20, -1, b"")]), 0)
    assert [item.end for item in decoder.decode([delivered(sealed, 30)])] == [5, 10, 20, 30]
    assert decoder.decode([delivered(sealed)])[-1].end is None


def test_ends_hold_across_the_runs_of_one_answer() -> None:
    first, second = (
        seal_run(encoded([(0, -1, b""), (10, -1, b"")]), 0),
        seal_run(encoded([(10, -1, b""), (20, -1, b"")]), 2),
    )
    assert [item.end for item in decoder.decode([delivered(first), delivered(second)])] == [10, 20, 20, None]


def test_the_next_run_of_a_subscription_does_not_end_the_spans_of_a_run() -> None:
    late, newer = seal_run(encoded([(5, -1, b"")]), 0), seal_run(encoded([(1, -1, b"")]), 1)
    decoded = decoder.decode_each([delivered(late), delivered(newer, 5)])
    assert [[item.end for item in run] for run in decoded] == [[None], [5]]


@pytest.mark.parametrize(
    ("run", "message"),
    [
        (item_pb2.ItemRun(), "no items"),
        (item_pb2.ItemRun(payload_length_bytes=[1], payloads=b"ab"), "add up"),
        (item_pb2.ItemRun(payload_length_bytes=[0, 0], time_unix_nano=[1]), "disagree"),
        (item_pb2.ItemRun(payload_length_bytes=[0], duration_nanos=[-2]), "duration of -2"),
        (item_pb2.ItemRun(payload_length_bytes=[0], first_seq=1), "first_seq"),
        (item_pb2.ItemRun(payload_length_bytes=[0] * (RUN_ITEMS_MAX + 1)), "split it"),
        (item_pb2.ItemRun(payload_length_bytes=[RUN_BYTES_MAX, 1], payloads=bytes(RUN_BYTES_MAX + 1)), "split it"),
        (item_pb2.ItemRun(payload_length_bytes=[0], content_type="x" * 256), "content type"),
        (item_pb2.ItemRun(payload_length_bytes=[0], attributes={"k": "v" * 17_000}), "attributes"),
    ],
)
def test_a_malformed_run_is_refused_with_its_fault(run: item_pb2.ItemRun, message: str) -> None:
    with pytest.raises(MalformedRun, match=message):
        parse_run(run.SerializeToString())


def test_bytes_that_are_no_run_are_refused() -> None:
    with pytest.raises(MalformedRun, match="not a valid ItemRun"):
        parse_run(b"\xff\xff\xff")


@pytest.mark.parametrize(
    "twice",
    [item_pb2.ItemRun(payloads=bytes(200)), item_pb2.ItemRun(content_type="x" * 200)],
)
def test_a_field_that_comes_twice_is_refused_because_the_bytes_of_both_would_be_kept(twice: item_pb2.ItemRun) -> None:
    with pytest.raises(MalformedRun, match="more than its fields take"):
        parse_run(twice.SerializeToString() + encode_run([b"one"], times=[1], content_type="text/plain"))


def test_the_client_copies_and_parses_only_the_fields_before_the_payloads_of_a_long_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parsed_bytes: list[int] = []

    class Counting:
        @staticmethod
        def FromString(raw: bytes) -> item_pb2.ItemRun:  # noqa: N802
            parsed_bytes.append(len(raw))
            return item_pb2.ItemRun.FromString(raw)

    large = item_pb2.ItemRun(payloads=bytes(4 * 2**20)).SerializeToString()
    packed = encode_run([bytes(4 * 2**20)], times=[1], attributes={"k": "v"})
    unpacked = bytes((1 << 3 | 1,)) + bytes(8) + bytes((3 << 3 | 5, 0, 0, 0x40, 0)) + large
    twice = large + encode_run([b"one"], times=[1])
    monkeypatch.setattr(runs, "item_pb2", SimpleNamespace(ItemRun=Counting))
    for raw in (packed, unpacked):
        assert parse_run(raw).lengths == [4 * 2**20]
    for raw in (twice, large + bytes((6 << 3 | 2, 0)), b"\xf8\x01\x01" + large):
        with pytest.raises(MalformedRun, match=r"each field of item\.proto once, and the payloads last"):
            parse_run(raw)
    assert max(parsed_bytes) < 100
    assert len(parsed_bytes) == 2


@settings(max_examples=200)
@given(
    strategies.lists(strategies.binary(max_size=3), min_size=1, max_size=RUN_ITEMS_MAX),
    strategies.dictionaries(strategies.text(max_size=4), strategies.text(max_size=200), max_size=20),
)
def test_no_run_of_the_contract_is_too_long(payloads: list[bytes], attributes: dict[str, str]) -> None:
    raw = encode_run(payloads, times=[1] * len(payloads), durations=[2] * len(payloads), attributes=attributes)
    unpacked = b"".join(
        bytes((1 << 3 | 1,)) + bytes(8) + bytes((2 << 3 | 1,)) + bytes(8) + bytes((3 << 3 | 5, len(one), 0, 0, 0))
        for one in payloads
    )
    assert len(parse_run(raw).lengths) == len(payloads)
    labels = item_pb2.ItemRun(attributes=attributes, payloads=b"".join(payloads)).SerializeToString()
    assert len(parse_run(unpacked + labels).lengths) == len(payloads)


def test_fields_that_the_contract_does_not_have_are_refused() -> None:
    with pytest.raises(MalformedRun, match="does not have"):
        parse_run(encode_run([b""], times=[1]) + bytes([15 << 3, 1]))


def test_an_item_beyond_the_limit_is_refused() -> None:
    with pytest.raises(ItemTooLarge, match="split it"):
        parse_run(encode_run([bytes(ITEM_BYTES_MAX + 1)], times=[1]))


def test_a_part_is_cut_out_of_bytes_that_another_encoder_wrote_in_its_own_way() -> None:
    sealed = seal_run(encode_run([b"one", b"two"], times=[1, 2], content_type="text/plain"), 5)
    run = item_pb2.ItemRun.FromString(sealed)
    in_pieces = b"".join(
        item_pb2.ItemRun(time_unix_nano=[time], payload_length_bytes=[3]).SerializeToString() for time in (1, 2)
    )
    unpacked = b"".join(b"\x09" + time.to_bytes(8, "little") + b"\x1d" + (3).to_bytes(4, "little") for time in (1, 2))
    rest = item_pb2.ItemRun(content_type="text/plain", payloads=b"onetwo", first_seq=5).SerializeToString()
    for odd in (in_pieces + rest, rest + in_pieces, unpacked + rest, b"\x32\x03old" + sealed):
        assert item_pb2.ItemRun.FromString(odd) == run
        second = item_pb2.ItemRun.FromString(slice_run(odd, 1, 2))
        assert second == item_pb2.ItemRun(
            time_unix_nano=[2], payload_length_bytes=[3], content_type="text/plain", payloads=b"two", first_seq=6
        )


@pytest.mark.parametrize(
    "change", ["payloads twice", "payloads first", "unknown field behind", "too short", "endless number"]
)
def test_a_long_run_is_judged_as_a_short_one(change: str) -> None:
    """The parser gets a long run without its payloads. A run in an unusual form goes to the parser whole."""
    payload = bytes(5000)
    raw = encode_run([payload], times=[1])
    columns = encode_run([b""], times=None)
    long_column = item_pb2.ItemRun(payload_length_bytes=[len(payload)]).SerializeToString()
    payloads = item_pb2.ItemRun(payloads=payload).SerializeToString()
    assert parse_run(payloads + long_column).lengths == [len(payload)]
    changed = {
        "payloads twice": payloads + raw,
        "payloads first": payloads + columns,
        "unknown field behind": raw + bytes([15 << 3, 1]),
        "too short": raw[:-1],
        "endless number": bytes([1 << 3 | 2]) + b"\x80" * 5000,
    }[change]
    with pytest.raises(MalformedRun):
        parse_run(changed)
    with pytest.raises(MalformedRun):
        parse_run(memoryview(changed))
