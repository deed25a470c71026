"""Requests to the process that forks the services of the tests."""

from __future__ import annotations

import functools
import socket

import pytest

from tests.support.forking import forked_popen


def test_the_answer_to_an_interrupted_request_is_not_taken_for_the_answer_to_the_next_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(2)]
    unused = iter(pairs)
    monkeypatch.setattr(forked_popen, "_loaded_process", functools.cache(lambda: next(unused)[0]))
    pairs[0][0].setblocking(False)  # the child's answer comes too late

    with pytest.raises(BlockingIOError):
        forked_popen._fork(b"{}", [])
    pairs[1][1].send(b"7")

    assert forked_popen._fork(b"{}", []) == 7
    for ours, its in pairs:
        ours.close()
        its.close()


def test_a_request_has_a_limit() -> None:
    assert forked_popen._loaded_process().gettimeout() == forked_popen._FORK_S_MAX
