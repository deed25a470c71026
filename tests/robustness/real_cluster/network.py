"""Links between namespaces that can be cut in either direction, and how one sees that they are."""

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

WITNESS_PORT = 7598
WITNESS_SECONDS = 0.3


class Network(namespaces.NamespaceNetwork):
    """Places that reach each other as long as nothing is blocked or unplugged, with a witness in each."""

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self._drops_silently = shutil.which("iptables") is not None
        self._witnesses: dict[str, socket.socket] = {}

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            for namespace in self.namespaces:
                self._witnesses[namespace.name] = _socket_inside(namespace)
        except BaseException:
            self.close()
            raise
        return self

    def close(self) -> None:
        """Take everything down; what was not made yet is passed over."""
        for witness in self._witnesses.values():
            witness.close()
        super().close()

    def block(self, sender: NetworkNamespace, receiver: NetworkNamespace) -> None:
        """From now on nothing that `sender` sends reaches `receiver`; the other direction stays as it is."""
        if self._drops_silently:
            rule = ("INPUT", "-s", sender.address, "-j", "DROP")
            run(receiver.command("iptables", "-C", *rule), check=False) or run(
                receiver.command("iptables", "-A", *rule)
            )
        else:
            run(sender.command("ip", "route", "replace", "blackhole", f"{receiver.address}/32"))

    def unblock_all(self) -> None:
        """Everything passes again."""
        for namespace in self.namespaces:
            if self._drops_silently:
                run(namespace.command("iptables", "-F", "INPUT"))
            else:
                run(namespace.command("ip", "route", "flush", "type", "blackhole"), check=False)

    def plug(self, namespace: NetworkNamespace, *, in_: bool) -> None:
        """Pull the place's cable, or put it back in."""
        ip("link", "set", namespace.outer_link, "up" if in_ else "down")

    def ways(self, namespaces: Iterable[NetworkNamespace]) -> set[tuple[NetworkNamespace, NetworkNamespace]]:
        """From whom to whom a datagram arrives at this moment, of all pairs. Blocks for WITNESS_SECONDS at most."""
        tokens: dict[bytes, tuple[NetworkNamespace, NetworkNamespace]] = {}
        for sender, receiver in itertools.permutations(namespaces, 2):
            tokens[token := secrets.token_bytes(8)] = (sender, receiver)
            with contextlib.suppress(OSError):  # the sender was told that there is no way
                self._witnesses[sender.name].sendto(token, (receiver.address, WITNESS_PORT))
        deadline = time.monotonic() + WITNESS_SECONDS
        arrived = set()
        for receiver in {receiver for _, receiver in tokens.values()}:
            arrived |= {tokens[token] for token in self._inbox(receiver, deadline) if token in tokens}
        return arrived

    def _inbox(self, namespace: NetworkNamespace, deadline: float) -> Iterator[bytes]:
        """What has arrived there, and what does until `deadline`."""
        inbox = self._witnesses[namespace.name]
        while True:
            inbox.settimeout(max(0.001, deadline - time.monotonic()))
            try:
                yield inbox.recv(64)
            except TimeoutError:
                return


def _socket_inside(namespace: NetworkNamespace) -> socket.socket:
    """A socket of this process in the namespace of `namespace`. Only the thread that makes it goes there."""

    def make() -> socket.socket:
        namespace.enter()
        witness = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        witness.bind((namespace.address, WITNESS_PORT))
        return witness

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(make).result()
