"""The checksums of blocks are those of zlib, whichever library computes them."""

from __future__ import annotations

import importlib.util
import random
import sys
import zlib

import pytest

from stampede_rt.wire.runs import run_parts, seal_run
from stampede_rt_channel_host.core.archive import block
from stampede_rt_channel_host.core.archive.block import ArchivedRun, decode_head, encode_items, is_whole
from stampede_rt_channel_host.core.channel import ReferencedBody
from stampede_rt_channel_host.core.channel.run import SingleItemRun


@pytest.mark.parametrize("length", [0, 1, 15, 16, 80, 255, 256, 257, 4095, 4097, 300_001])
def test_a_checksum_equals_zlib_crc32_also_when_it_continues_another_checksum(length: int) -> None:
    draw = random.Random(length)
    data = draw.randbytes(length)
    assert block.crc32(data) == zlib.crc32(data)
    for at in {0, length // 3, length}:
        assert block.crc32(data[at:], block.crc32(data[:at])) == zlib.crc32(data)
    begin = draw.getrandbits(32)
    assert block.crc32(memoryview(data), begin) == zlib.crc32(data, begin)


def test_a_host_without_isal_writes_the_same_blocks_and_finds_each_flipped_bit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "isal.isal_zlib", None)
    found = importlib.util.find_spec(block.__name__)
    assert found is not None
    assert found.loader is not None
    other = importlib.util.module_from_spec(found)
    found.loader.exec_module(other)
    assert other.crc32 is zlib.crc32
    body = ReferencedBody(run_parts((bytes(5000),), times=(7,)), bytes(5000), {}, "").followed_by(seal_run(b"", 1))
    run = ArchivedRun(1, SingleItemRun(1, 7, -1, 5000, body))
    head, (encoded, *content) = encode_items([run])
    assert (head, [encoded, *content]) == other.encode_items([run])
    assert decode_head(encoded) == other.decode_head(encoded)
    whole = b"".join(content)
    for at in range(0, len(whole) * 8, 997):
        flipped = bytearray(whole)
        flipped[at // 8] ^= 1 << at % 8
        assert not is_whole(head, bytes(flipped))
        assert not other.is_whole(head, bytes(flipped))
