"""An owner hands a channel or queue over only to a host that a caller has named, at this epoch, and not long ago."""

from __future__ import annotations

import pytest

from stampede_rt.errors import PermissionDenied
from stampede_rt_channel_host.copies.moves import allowed_moves
from stampede_rt_channel_host.copies.moves.allowed_moves import ALLOWED_SECONDS, AllowedMoves
from stampede_rt_runtime.access.move_permits import is_permit

KEY, CHANNEL, HOST, OTHER = b"k" * 32, b"c" * 16, b"h" * 16, b"o" * 16


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_only_the_named_host_may_ask_and_only_at_this_epoch() -> None:
    moves = AllowedMoves(KEY)
    moves.allow(CHANNEL, 3, HOST)
    moves.check("channel cam", CHANNEL, 3, HOST)
    for subject_id, epoch, host_id in ((CHANNEL, 3, OTHER), (CHANNEL, 4, HOST), (OTHER, 3, HOST)):
        with pytest.raises(PermissionDenied, match="hand channel cam over"):
            moves.check("channel cam", subject_id, epoch, host_id)


def test_a_permission_to_move_ends_after_a_minute_unless_it_is_repeated() -> None:
    clock = Clock()
    moves = AllowedMoves(KEY, clock)
    moves.allow(CHANNEL, 3, HOST)
    clock.now_s += ALLOWED_SECONDS / 2
    moves.allow(CHANNEL, 3, HOST)
    clock.now_s += ALLOWED_SECONDS
    moves.check("channel cam", CHANNEL, 3, HOST)
    clock.now_s += 0.1
    with pytest.raises(PermissionDenied):
        moves.check("channel cam", CHANNEL, 3, HOST)


def test_the_oldest_permission_is_dropped_if_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(allowed_moves, "ALLOWED_MAX", 2)
    moves = AllowedMoves(KEY)
    for epoch in (1, 2, 3):
        moves.allow(CHANNEL, epoch, HOST)
    moves.check("channel cam", CHANNEL, 3, HOST)
    with pytest.raises(PermissionDenied):
        moves.check("channel cam", CHANNEL, 1, HOST)


def test_the_directory_accepts_the_permit_of_a_host() -> None:
    assert is_permit(AllowedMoves(KEY).permit(CHANNEL, 3, HOST), KEY, CHANNEL, 3, HOST)
    assert AllowedMoves(b"").permit(CHANNEL, 3, HOST) == b"", "the directory has no key of this host"
