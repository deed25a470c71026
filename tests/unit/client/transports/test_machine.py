"""Unix sockets between processes of one machine."""

from __future__ import annotations

import socket

from stampede_rt.transports.machine import send_more_at_once


def test_the_system_takes_a_message_of_300_kb_in_one_call() -> None:
    sending, receiving = socket.socketpair()
    with sending, receiving:
        sending.setblocking(False)
        send_more_at_once(sending)
        assert sending.send(bytes(300_000)) == 300_000
