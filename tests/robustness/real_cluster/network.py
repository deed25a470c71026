"""Links between namespaces, which tests can cut in either direction, and checks that a cut has its effect."""

from __future__ import annotations

import contextlib
import itertools
import secrets
import shutil
import socket
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Self

from stampede_rt_local import namespaces
from stampede_rt_local.namespaces import NetworkNamespace, ip, run

PROBE_PORT = 7598
PROBE_SECONDS = 0.3


class Network(namespaces.NamespaceNetwork):
    """Namespaces that reach each other unless a test cuts a link.

    Each namespace has a probe socket, which sends and receives datagrams.
    """

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self._drops_silently = shutil.which("iptables") is not None
        self._probe_sockets: dict[str, socket.socket] = {}

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            for namespace in self.namespaces:
                self._probe_sockets[namespace.name] = _socket_inside(namespace)
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """Remove everything that was made."""
        for probe_socket in self._probe_sockets.values():
            probe_socket.close()
        super().close()

    def block(self, sender: NetworkNamespace, receiver: NetworkNamespace) -> None:
        """Cut the direction from `sender` to `receiver`. The other direction stays as it is."""
        if self._drops_silently:
            rule = ("INPUT", "-s", sender.address, "-j", "DROP")
            run(receiver.command("iptables", "-C", *rule), check=False) or run(
                receiver.command("iptables", "-A", *rule)
            )
        else:
            run(sender.command("ip", "route", "replace", "blackhole", f"{receiver.address}/32"))

    def unblock_all(self) -> None:
        """End all cuts."""
        for namespace in self.namespaces:
            if self._drops_silently:
                run(namespace.command("iptables", "-F", "INPUT"))
            else:
                run(namespace.command("ip", "route", "flush", "type", "blackhole"), check=False)

    def set_link(self, namespace: NetworkNamespace, *, up: bool) -> None:
        """Cut the link of the namespace, or connect it again."""
        ip("link", "set", namespace.outer_link, "up" if up else "down")

    def open_directions(self, namespaces: Iterable[NetworkNamespace]) -> set[tuple[NetworkNamespace, NetworkNamespace]]:
        """All pairs of a sender and a receiver for which a datagram arrives at this moment.

        Blocks for PROBE_SECONDS at most.
        """
        tokens: dict[bytes, tuple[NetworkNamespace, NetworkNamespace]] = {}
        for sender, receiver in itertools.permutations(namespaces, 2):
            tokens[token := secrets.token_bytes(8)] = (sender, receiver)
            with contextlib.suppress(OSError):  # the system reported that there is no route
                self._probe_sockets[sender.name].sendto(token, (receiver.address, PROBE_PORT))
        deadline = time.monotonic() + PROBE_SECONDS
        arrived = set()
        for receiver in {receiver for _, receiver in tokens.values()}:
            arrived |= {tokens[token] for token in self._inbox(receiver, deadline) if token in tokens}
        return arrived

    def _inbox(self, namespace: NetworkNamespace, deadline: float) -> Iterator[bytes]:
        """All datagrams that arrive there until `deadline`, and all unread earlier ones."""
        inbox = self._probe_sockets[namespace.name]
        while True:
            inbox.settimeout(max(0.001, deadline - time.monotonic()))
            try:
                yield inbox.recv(64)
            except TimeoutError:
                return


def _socket_inside(namespace: NetworkNamespace) -> socket.socket:
    """A socket of this process in another namespace. Only the thread that makes the socket enters the namespace."""

    def make() -> socket.socket:
        namespace.enter()
        probe_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        probe_socket.bind((namespace.address, PROBE_PORT))
        return probe_socket

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(make).result()
