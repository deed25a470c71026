"""A network between namespaces that loses, repeats and reorders multicast datagrams. All other frames pass the bridge.

The kernel here has no netem. So the bridge passes no multicast to the receivers, and a thread of this process carries
the frames from one link to the others.
"""

from __future__ import annotations

import random
import select
import socket
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from stampede_rt_local.namespaces import NetworkNamespace, ip

ETH_P_ALL = 3
MULTICAST_MAC = b"\x01\x00\x5e"
UDP_CHECKSUM = slice(40, 42)  # in a frame with an IPv4 header of 20 bytes
UDP_AT = 23
SILENT_S = 0.02


class LossyMulticast:
    """Carries multicast from `sender` to `receivers`. Of each receiver's frames it loses the part `loss`.

    It holds the part `late` of the frames back until the next few frames have passed. `carried` and `lost` count
    frames.
    """

    def __init__(
        self, sender: NetworkNamespace, receivers: Sequence[NetworkNamespace], *, loss: float, late: float, seed: int
    ) -> None:
        self.loss, self.late, self.carried, self.lost = loss, late, 0, 0
        self._rng = random.Random(seed)
        for one in receivers:
            ip("link", "set", one.outer_link, "type", "bridge_slave", "mcast_flood", "off")
        self._from = _frames_of(sender.outer_link)
        self._to = {one.outer_link: _frames_of(one.outer_link) for one in receivers}
        self._held: dict[str, list[bytes]] = {link: [] for link in self._to}
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stopped.set()
        self._thread.join(10)
        for one in (self._from, *self._to.values()):
            one.close()

    def _run(self) -> None:
        while not self._stopped.is_set():
            if select.select([self._from], [], [], SILENT_S)[0]:
                frame, (_, _, kind, *_) = self._from.recvfrom(2048)
                if frame.startswith(MULTICAST_MAC) and frame[UDP_AT] == socket.IPPROTO_UDP and kind != 4:
                    self._carry(bytearray(frame))
            else:
                self._release()

    def _carry(self, frame: bytearray) -> None:
        frame[UDP_CHECKSUM] = b"\0\0"  # the sender leaves the checksum to the network card; 0: no checksum
        for link, to in self._to.items():
            chance = self._rng.random()
            if chance < self.loss:
                self.lost += 1
            elif chance < self.loss + self.late:
                self._held[link].append(bytes(frame))
            else:
                self.carried += 1
                to.send(frame)
            if len(self._held[link]) > self._rng.randrange(1, 6):
                self._release()

    def _release(self) -> None:
        for link, held in self._held.items():
            self._rng.shuffle(held)
            for frame in held:
                self.carried += 1
                self._to[link].send(frame)
            held.clear()


def _frames_of(link: str) -> socket.socket:
    """A socket for the raw frames of a link, in both directions."""
    made = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
    made.bind((link, 0))
    return made
