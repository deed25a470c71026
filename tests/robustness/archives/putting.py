"""A program that puts numbers with ack="disk", and notes the acknowledged numbers."""

from __future__ import annotations

import threading

import stampede_rt as st

WAIT_SECONDS_MAX = 120
PAYLOAD_BYTES = 200


class NumberProducer:
    """Puts numbers one after the other, in a thread, until `stop` is called. A refused number is put again.

    `acked` are the acknowledged numbers, as payloads. `refused` counts the puts that the host refused because its disk
    was full.
    """

    def __init__(self, channel: st.Channel, first: int) -> None:
        self.acked: list[bytes] = []
        self.refused = 0
        self._channel = channel
        self._number = first
        self._stopping = threading.Event()
        self._moved = threading.Condition()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stopping.is_set():
            payload = b"%d " % self._number
            try:
                self._channel.put(payload.ljust(PAYLOAD_BYTES, b"."), timeout=5, ack="disk")
            except st.NotArchived:
                self.refused += 1
                self._stopping.wait(0.01)
            except st.StampedeError:  # the host is unreachable
                self._stopping.wait(0.01)
            else:
                self._number += 1
                self.acked.append(payload.strip())
            with self._moved:
                self._moved.notify_all()

    def wait_for_acks(self, count: int) -> None:
        """Wait until this number of further puts is acknowledged."""
        wanted = len(self.acked) + count
        with self._moved:
            assert self._moved.wait_for(lambda: len(self.acked) >= wanted, WAIT_SECONDS_MAX)

    def wait_for_refusals(self, count: int) -> None:
        """Wait until the host has refused this number of further puts."""
        wanted = self.refused + count
        with self._moved:
            assert self._moved.wait_for(lambda: self.refused >= wanted, WAIT_SECONDS_MAX)

    def stop(self) -> None:
        """Stop, after the present put."""
        self._stopping.set()
        self._thread.join(WAIT_SECONDS_MAX)
