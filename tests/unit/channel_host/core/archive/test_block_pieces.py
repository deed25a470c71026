"""The parts of a block: a long payload of a program of the same process is written as it is."""

from __future__ import annotations

import pytest

from stampede_rt.wire.runs import run_parts, seal_run
from stampede_rt_channel_host.core.archive.block import ArchivedRun, encode_items, is_whole
from stampede_rt_channel_host.core.channel import ReferencedBody
from stampede_rt_channel_host.core.channel.run import SingleItemRun


@pytest.mark.parametrize(("length", "is_same"), [(300_000, True), (100, False)])
def test_only_a_long_payload_is_not_copied(length: int, is_same: bool) -> None:
    payload = bytes(length)
    body = ReferencedBody(run_parts((payload,), times=(7,)), payload, {}, "").followed_by(seal_run(b"", 1))
    head, (_, *content) = encode_items([ArchivedRun(1, SingleItemRun(1, 7, -1, length, body))])
    assert any(part is payload for part in content) is is_same
    assert is_whole(head, b"".join(content))
    assert b"".join(content).endswith(bytes(body))
