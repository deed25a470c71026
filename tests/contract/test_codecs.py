"""Codecs: values in, values out, over the network and back, on both clients."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import stampede_rt as st
from tests.contract.surfaces import Surface, take

pytestmark = pytest.mark.parametrize("surface", ["aio", "sync"], indirect=True)

READ_ELSEWHERE = """
import sys
import stampede_rt as st
address, name = sys.argv[1:]
with st.connect(address) as rt:
    item = rt.channel(name, create=False, codec="numpy").newest()
    plain = rt.channel(name, create=False).newest()
    print(item.value.dtype, item.value.shape, item.value.sum(), plain.content_type, plain.value == plain.payload)
"""


class Shout:
    content_type = "text/x-shout"
    decoded = 0

    def encode(self, value: str) -> bytes:
        return value.upper().encode()

    def decode(self, payload: bytes) -> str:
        self.decoded += 1
        return payload.decode("ascii")


async def test_without_a_codec_the_value_is_the_payload(surface: Surface) -> None:
    channel = await surface.channel(codec="bytes")
    assert (await channel.put(b"raw")).value == b"raw"
    assert (await channel.newest()).value == b"raw"


@pytest.mark.parametrize("value", [None, True, 3, "Größe", [1, {"a": [2.5]}], {"pose": [0.0, 1.0]}])
async def test_a_json_value_is_read_as_it_was_put(surface: Surface, value: Any) -> None:
    channel = await surface.channel(codec="json")
    put = await channel.put(value)
    item = await channel.newest()
    assert (put.value, item.value, item.content_type) == (value, value, "application/json")


@pytest.mark.parametrize(
    "array",
    [
        np.arange(24, dtype=np.uint8).reshape(2, 3, 4),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.zeros((0, 5), np.int16),
        np.float32(2.5),
        np.arange(10)[::3],
        np.array([(1, 2.0)], dtype=[("a", "<i4"), ("b", "<f8")]),
    ],
)
async def test_numpy_keeps_shape_and_dtype(surface: Surface, array: Any) -> None:
    channel = await surface.channel(codec="numpy")
    await channel.put(array)
    value = (await channel.newest()).value
    assert (value.shape, value.dtype) == (array.shape, array.dtype)
    assert np.array_equal(value, array)


async def test_another_process_learns_the_content_type_of_the_items(
    surface: Surface, request: pytest.FixtureRequest
) -> None:
    channel = await surface.channel(codec="numpy")
    await channel.put(np.arange(6, dtype=np.float32).reshape(2, 3))
    address = request.getfixturevalue("cluster").address
    command = [sys.executable, "-c", READ_ELSEWHERE, address, channel.name]
    found = await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=30, check=True)
    assert found.stdout == "float32 (2, 3) 15.0 application/x-npy True\n"


async def test_a_users_codec_decodes_an_item_at_its_first_use_and_only_once(surface: Surface) -> None:
    codec = Shout()
    channel = await surface.channel(codec=codec)
    await channel.put("hello")
    items = await channel.get(st.OLDEST, st.NEWEST)
    assert codec.decoded == 0
    assert [items[0].value, items[0].value] == ["HELLO", "HELLO"]
    assert (codec.decoded, items[0].content_type) == (1, "text/x-shout")


async def test_producers_and_subscriptions_have_values(surface: Surface) -> None:
    channel = await surface.channel(codec="json")
    async with channel.subscribe(start=st.OLDEST) as items:
        async with channel.producer() as producer:
            for number in range(3):
                await producer.put({"number": number})
        assert [item.value["number"] for item in await take(items, 3)] == [0, 1, 2]


async def test_a_payload_that_does_not_decode_names_the_channel_and_the_item(surface: Surface) -> None:
    plain = await surface.channel()
    put = await plain.put(b"{")
    item = await (await surface.channel(plain.name, codec="json")).newest()
    with pytest.raises(
        st.CodecError, match=rf"{plain.name}.*item #{put.seq} at {put.time}.*cannot be decoded as application/json"
    ):
        _ = item.value
    assert item.payload == b"{"


async def test_an_item_of_another_content_type_is_not_decoded(surface: Surface) -> None:
    channel = await surface.channel(codec="json")
    await channel.put([1])
    item = await (await surface.channel(channel.name, codec="numpy")).newest()
    with pytest.raises(st.CodecError, match="is application/json, not application/x-npy; name the codec"):
        _ = item.value


async def test_a_stated_content_type_labels_the_payloads_of_the_codec(surface: Surface) -> None:
    channel = await surface.channel(codec="json", content_type="application/geo+json")
    await channel.put({"type": "Point"})
    item = await channel.newest()
    assert (item.content_type, item.value) == ("application/geo+json", {"type": "Point"})


async def test_an_item_read_without_its_payload_has_no_value(surface: Surface) -> None:
    channel = await surface.channel(codec="json")
    await channel.put([1])
    assert (await channel.newest(payloads=False)).value is None


@pytest.mark.parametrize(("codec", "value"), [("json", {1, 2}), ("json", float("nan")), ("numpy", [object()])])
async def test_a_value_that_cannot_be_encoded_is_refused(surface: Surface, codec: str, value: Any) -> None:
    channel = await surface.channel(codec=codec)
    with pytest.raises(st.CodecError, match=f"{channel.name}.*cannot be encoded as application"):
        await channel.put(value)


@pytest.mark.parametrize("codec", ["yaml", 7, Shout])
async def test_an_unknown_codec_is_refused(surface: Surface, codec: Any) -> None:
    with pytest.raises(st.InvalidArgument, match="codec"):
        await surface.channel(codec=codec)
