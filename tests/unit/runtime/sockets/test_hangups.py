from __future__ import annotations

import asyncio
import os
import socket

from stampede_rt_runtime.sockets.hangups import HangupWatcher


async def test_the_close_of_a_watched_socket_is_told_once_although_nobody_reads() -> None:
    hangups = HangupWatcher()
    near, far = socket.socketpair()
    told = asyncio.Queue[str]()
    with near:
        hangups.watch(near, lambda: told.put_nowait("gone"))
        far.sendall(b"more")
        far.close()
        assert await asyncio.wait_for(told.get(), 20) == "gone"
        hangups.forget(near)
    hangups.close()
    assert told.empty()


async def test_a_socket_that_has_the_number_of_a_closed_one_stays_watched() -> None:
    hangups = HangupWatcher()
    closed, closed_far = socket.socketpair()
    near, far = socket.socketpair()
    told = asyncio.Queue[str]()
    hangups.watch(closed, lambda: told.put_nowait("closed"))
    os.dup2(near.fileno(), closed.fileno())  # the system closes the former file, and gives its number to another one
    with socket.socket(fileno=closed.detach()) as successor, closed_far:
        near.close()
        hangups.watch(successor, lambda: told.put_nowait("successor"))
        hangups.forget(closed)
        far.close()
        assert await asyncio.wait_for(told.get(), 20) == "successor"
    hangups.close()
