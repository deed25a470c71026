"""The client checks a host's messages before it makes items from them."""

from __future__ import annotations

from typing import Any

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import item_pb2
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.delivered import RESPONSE_ITEMS_MAX, RUN_ITEMS_MAX, ItemCount

GOOD: dict[str, Any] = {"time_unix_nano": [1, 2], "payload_length_bytes": [1, 2], "payloads": b"abc", "first_seq": 5}
HOSTILE: dict[str, tuple[dict[str, Any], str]] = {
    "no items": ({"time_unix_nano": [], "payload_length_bytes": []}, "0 lengths, 0 times and 0 durations"),
    "no times": ({"time_unix_nano": []}, "2 lengths, 0 times"),
    "too many times": ({"time_unix_nano": [1, 2, 3]}, "2 lengths, 3 times"),
    "one duration": ({"duration_nanos": [1]}, "2 lengths, 2 times and 1 durations"),
    "lengths beyond the payloads": ({"payload_length_bytes": [1, 2**32 - 1]}, "and payloads of 3 bytes"),
    "payloads beyond the lengths": ({"payloads": b"abcd"}, "lengths of 3 bytes in all and payloads of 4 bytes"),
    "seqs beyond the last": ({"first_seq": 2**64 - 1}, "2 items from seq 18446744073709551615 on"),
    "very many items": (
        {"time_unix_nano": [1] * (RUN_ITEMS_MAX + 1), "payload_length_bytes": [0] * (RUN_ITEMS_MAX + 1)},
        "257 lengths",
    ),
}


def run(**fields: Any) -> item_pb2.ItemRun:
    return item_pb2.ItemRun(**(GOOD | fields))


def decoder(*, payloads: bool = True) -> ItemDecoder:
    return ItemDecoder(incarnation=7, content_type="", payloads=payloads)


@pytest.mark.parametrize("case", HOSTILE)
def test_a_run_whose_columns_disagree_is_refused_with_a_sentence(case: str) -> None:
    fields, why = HOSTILE[case]
    sent = [item_pb2.DeliveredRun(run=run(**fields))]
    for decode in (decoder().decode, decoder().decode_each):
        with pytest.raises(StampedeError, match="a host sent a run with") as caught:
            decode(sent)
        assert why in caught.value.message


@pytest.mark.parametrize("columns", [{"time_unix_nano": []}, {"payload_length_bytes": []}, {"duration_nanos": [1, 2]}])
def test_a_run_of_one_item_is_checked_as_well(columns: dict[str, Any]) -> None:
    one = run(**({"time_unix_nano": [1], "payload_length_bytes": [3]} | columns))
    with pytest.raises(StampedeError):
        decoder().decode([item_pb2.DeliveredRun(run=one)])


def test_without_payloads_only_the_lengths_are_reported() -> None:
    bare = run(payloads=b"")
    items = decoder(payloads=False).decode([item_pb2.DeliveredRun(run=bare)])
    assert [one.payload_length_bytes for one in items] == [1, 2]


def test_a_response_of_very_many_items_is_refused_before_any_is_made() -> None:
    many = run(time_unix_nano=[], payload_length_bytes=[0] * (RESPONSE_ITEMS_MAX + 1), payloads=b"")
    with pytest.raises(StampedeError, match=f"sent {RESPONSE_ITEMS_MAX + 1} items, and one response has"):
        ItemCount().add([many])


def test_more_items_than_the_request_asked_for_are_refused_over_all_responses() -> None:
    count = ItemCount(limit=3)
    count.add([run()])
    with pytest.raises(StampedeError, match="sent 4 items, and the request asked for 3 at most"):
        count.add([run()])
