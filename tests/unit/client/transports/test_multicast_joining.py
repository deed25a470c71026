"""A reader's socket in a multicast group."""

from __future__ import annotations

import errno
import os
import socket
import threading

import pytest

from stampede_rt.transports import multicast_joining
from stampede_rt.transports.multicast_joining import join_group


def test_a_forked_child_does_not_stay_in_the_group() -> None:
    with join_group("239.255.7.9:7589", "127.0.0.1:1") as joined:
        number = joined.fileno()
        child = os.fork()
        if not child:
            os._exit(0 if _is_closed(number) else 1)
        assert os.waitpid(child, 0)[1] == 0
        assert not _is_closed(number)


def test_a_resolver_that_does_not_answer_holds_a_reader_for_a_limited_time(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = threading.Event()

    def resolve(*_: object) -> None:
        answers.wait(60)
        raise OSError

    monkeypatch.setattr(multicast_joining, "RESOLVE_S_MAX", 0.01)
    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    with pytest.raises(OSError, match="a-host has no IPv4 address"):
        join_group("239.255.7.9:7589", "a-host:1")
    answers.set()


def _is_closed(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError as error:
        return error.errno == errno.EBADF
    return False
