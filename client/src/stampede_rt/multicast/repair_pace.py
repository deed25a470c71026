"""Decides when a reader asks the host for missing items, and when it gives multicast up. Pure."""

from __future__ import annotations

from enum import Enum

REORDERED_S = 0.02  # a reader waits this long for missing datagrams, because datagrams may overtake each other
BEAT_S_MAX = 1.0  # a host without new items sends a heartbeat at least this often
SILENT_S = 3.5 * BEAT_S_MAX  # after this time without a message, datagrams do not reach the reader any more
# After this many repairs in a row without an item by multicast, the network or the reader counts as too slow for
# multicast.
REPAIRS_WITHOUT_ITEM_MAX = 64
# A reader requests a new key at most once in this time, because anybody can send datagrams that name another key.
KEY_REQUEST_S = 1.0


class RepairStep(Enum):
    """The next step of a reader that has no item to give."""

    WAIT = "wait"
    REPAIR = "repair"
    REOPEN = "reopen"
    LEAVE = "leave"


class RepairPace:
    """The pace of one reader. Its caller passes the time in seconds, of a clock that never goes back.

    `repairs` counts the requests for missing items.
    """

    def __init__(self, now_s: float) -> None:
        self.repairs = 0
        self._last_received_s = now_s
        self._looked_s: float | None = None
        self._missing_since_s: float | None = None
        self._repairs_without_item = 0
        self._key_requested_s = now_s - KEY_REQUEST_S
        self._needs_key = self._has_ended = False

    def note_look(self, now_s: float) -> None:
        """Note that the reader looks for datagrams.

        A waiting reader looks at least every BEAT_S_MAX. If it does not look for a longer time, the program has paused,
        and this time does not count as silence of the host.
        """
        if self._looked_s is not None:
            self._last_received_s += max(0.0, now_s - self._looked_s - BEAT_S_MAX)
        self._looked_s = now_s

    def note_message(self, now_s: float) -> None:
        """Note a message of the host."""
        self._last_received_s = now_s

    def note_items(self) -> None:
        """Note that items came by multicast, in time."""
        self._repairs_without_item = 0

    def note_end(self) -> None:
        """Note that the host sends no further datagrams.

        The datagrams do not give the reason. A reader that opens a stream again gets the reason, or the channel's new
        host.
        """
        self._has_ended = True

    def note_other_key(self, now_s: float) -> None:
        """Note a datagram that names another key. The next step then requests this key."""
        if now_s - self._key_requested_s >= KEY_REQUEST_S:
            self._key_requested_s, self._needs_key = now_s, True

    def note_request(self) -> None:
        """Note that the reader has sent a request to the host, and has the answer."""
        self.repairs += 1
        if not self._needs_key:  # a request for a key says nothing about the network
            self._repairs_without_item += 1
        self._missing_since_s, self._needs_key = None, False

    def next_step(self, now_s: float, *, is_missing: bool) -> tuple[RepairStep, float]:
        """Return the next step, and for RepairStep.WAIT the longest wait in seconds."""
        if self._has_ended:
            return RepairStep.REOPEN, 0.0
        if now_s - self._last_received_s > SILENT_S or self._repairs_without_item > REPAIRS_WITHOUT_ITEM_MAX:
            return RepairStep.LEAVE, 0.0
        if self._needs_key:
            return RepairStep.REPAIR, 0.0
        if not is_missing:
            self._missing_since_s = None
            return RepairStep.WAIT, self._last_received_s + SILENT_S - now_s + 0.01
        if self._missing_since_s is None:
            self._missing_since_s = now_s
        left_s = self._missing_since_s + REORDERED_S - now_s
        return (RepairStep.WAIT, left_s) if left_s > 0 else (RepairStep.REPAIR, 0.0)
