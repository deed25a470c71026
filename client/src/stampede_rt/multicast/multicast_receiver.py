"""Makes items in order from the datagrams that one reader receives in a multicast group. Pure, but needs
`cryptography`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from stampede_rt.multicast.assembling import Assembler
from stampede_rt.multicast.encryption import DatagramOpener, RejectReason, Verifier
from stampede_rt.multicast.layout import MessageKind, MessagePart, MulticastMessage
from stampede_rt.multicast.repair_pace import RepairPace
from stampede_rt.multicast.seq_merge import SeqMerge
from stampede_rt.values.statistics import MulticastStats

ASSEMBLED_BYTES_MAX = 4 * 2**20
"""The most memory of the parts of messages that are not complete."""
HELD_BYTES_MAX = 4 * 2**20
"""The most memory of the items that wait for earlier ones."""
ITEM_MEMORY_BYTES = 256
"""The approximate memory of a decoded item besides its bytes in the message."""


class MulticastReceiver:
    """The datagrams of one stream, for one reader. Times are in seconds.

    With `merge.pass_to` the caller states where the reader begins.
    `decode` makes the items of a message's body. `merge` has the items, `pace` says when to ask the host.
    """

    def __init__(
        self,
        opener: DatagramOpener,
        verifier: Verifier,
        now_s: float,
        decode: Callable[[bytes], Sequence[Any]],
    ) -> None:
        self.opener = opener
        self._verifier, self._decode = verifier, decode
        self._assembler = Assembler(ASSEMBLED_BYTES_MAX)
        self.merge: SeqMerge[Any] = SeqMerge(1, HELD_BYTES_MAX)
        self.pace = RepairPace(now_s)
        self.has_received = False  # whether a message of the host has come
        self._last_beat = 0
        self._counts = Counter[str]()

    def take(self, datagrams: Iterable[bytes], now_s: float) -> list[Any]:
        """Take datagrams. Returns the items that come next, if any."""
        self.take_datagrams(datagrams, now_s)
        items = self.merge.take()
        if items:
            self.pace.note_items()
            self._assembler.forget_before(self.merge.next_seq)
        return items

    def take_datagrams(self, datagrams: Iterable[bytes], now_s: float) -> None:
        """Take datagrams, and keep their items."""
        for datagram in datagrams:
            opened = self.opener.open(datagram)
            if isinstance(opened, MessagePart):
                self._take_part(opened, now_s)
            else:
                self._reject(opened, now_s)

    def stats(self, group: str, *, following: bool) -> MulticastStats:
        """The counts so far."""
        counts = dict(self._counts)
        counts["repeated"] = counts.get("repeated", 0) + self._assembler.repeated
        items, repairs = self.merge.taken, self.pace.repairs
        return MulticastStats(group=group, following=following, items=items, repairs=repairs, **counts)

    def _reject(self, rejected: RejectReason, now_s: float) -> None:
        self._counts[rejected.value] += 1
        if rejected is RejectReason.OTHER_KEY:
            self.pace.note_other_key(now_s)

    def _take_part(self, part: MessagePart, now_s: float) -> None:
        self._counts["datagrams"] += 1
        if self.has_received and part.kind is MessageKind.ITEMS and part.end_seq <= self.merge.next_seq:
            self._counts["repeated"] += 1
            return
        message = self._assembler.add(part)
        if message is None:
            return
        verified = self._verifier.verify(message)
        if verified is None:
            self._counts["forged"] += 1
        elif self._take_message(verified):
            self.has_received = True
            self.pace.note_message(now_s)
        else:
            self._counts["repeated"] += 1

    def _take_message(self, message: MulticastMessage) -> bool:
        """Take a message of the host. Returns False if it is an old one."""
        if message.kind is MessageKind.ITEMS:
            items = self._decode(message.body)
            size = len(message.body) + ITEM_MEMORY_BYTES * len(items)
            is_new = self.merge.add(message.first_seq, message.end_seq, items, size)
            return is_new or not self.has_received
        beat = int.from_bytes(message.body, "big")
        if beat <= self._last_beat:
            return False
        self._last_beat = beat
        self.merge.announce(message.first_seq)
        if message.kind is MessageKind.END:
            self.pace.note_end()
        return True
