"""Checks that answers over a path equal the answers of the oracle, to the nanosecond and the byte."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import stampede_rt as st
from stampede_rt_channel_host.core.channel import Query
from tests.oracle import Item, OracleAnswer

Contents = Mapping[int, bytes]
"""Payloads by seq."""


def same_answer(found: st.Items, expected: OracleAnswer, query: Query, contents: Contents | None) -> None:
    """Check a whole answer. `contents` None: the read asked for no payloads."""
    assert not isinstance(found, BaseException), found
    same_found(found, expected, query, contents)
    assert (found.interval, found.complete, found.truncated, found.more, found.reason) == (
        expected.interval,
        expected.complete,
        expected.truncated,
        expected.more,
        expected.reason,
    )
    assert found.reason is None or found.reason.detail


def same_found(found: Sequence[st.Item], expected: OracleAnswer, query: Query, contents: Contents | None) -> None:
    """Check the items of an answer, in the order that the read asked for."""
    pairs = list(zip(expected.items, expected.ends, strict=True))
    same_items(found, pairs[::-1] if query.newest_first else pairs, contents)


def same_items(
    found: Sequence[st.Item], expected: Sequence[tuple[Item, int | None]], contents: Contents | None
) -> None:
    """Check items and the ends of their spans."""
    facts = [(item.time, item.seq, item.duration, item.end, item.payload_length_bytes) for item in found]
    assert facts == [(item.time, item.seq, item.duration, end, item.length) for item, end in expected]
    payloads = [None if contents is None else contents[item.seq] for item, _ in expected]
    assert [item.payload for item in found] == payloads
