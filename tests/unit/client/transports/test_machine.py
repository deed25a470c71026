"""Unix sockets between processes of one machine."""

from __future__ import annotations

import socket

from stampede_rt.transports.machine import enlarge_send_buffer


def test_the_system_takes_a_message_of_300_kb_in_one_call() -> None:
    sending, receiving = socket.socketpair()
    with sending, receiving:
        sending.setblocking(False)
        enlarge_send_buffer(sending)
        assert sending.send(bytes(300_000)) == 300_000
