"""The latest requests that deleted a channel."""

from __future__ import annotations

from stampede_rt_channel_host.channels.deletions import DELETIONS_MAX, Deletions


def test_a_caller_with_very_many_deletions_displaces_only_its_own_remembered_requests() -> None:
    deletions = Deletions()
    deletions.note(b"good", "good")
    for number in range(2 * DELETIONS_MAX):
        deletions.note(b"%d" % number, "greedy")
    assert b"good" in deletions
    assert b"0" not in deletions
    assert b"%d" % (2 * DELETIONS_MAX - 1) in deletions
    assert len(deletions._callers) == DELETIONS_MAX
