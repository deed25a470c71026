"""A permit is for one owner, one channel, one epoch and one host."""

from __future__ import annotations

import pytest

from stampede_rt_runtime.access.move_permits import KEY_BYTES, is_permit, move_permit

KEY, CHANNEL, HOST = b"k" * KEY_BYTES, b"c" * 16, b"h" * 16


def test_a_permit_that_the_owner_signed_is_valid() -> None:
    assert is_permit(move_permit(KEY, CHANNEL, 3, HOST), KEY, CHANNEL, 3, HOST)


@pytest.mark.parametrize(
    ("key", "channel", "epoch", "host"),
    [
        (b"x" * KEY_BYTES, CHANNEL, 3, HOST),
        (KEY, b"d" * 16, 3, HOST),
        (KEY, CHANNEL, 4, HOST),
        (KEY, CHANNEL, 3, b"i" * 16),
    ],
)
def test_a_permit_is_valid_for_no_other_move(key: bytes, channel: bytes, epoch: int, host: bytes) -> None:
    assert not is_permit(move_permit(key, channel, epoch, host), KEY, CHANNEL, 3, HOST)
    assert not is_permit(b"", KEY, CHANNEL, 3, HOST)
