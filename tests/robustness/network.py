"""Network namespaces, one per process, on a bridge: links that can be cut in either direction (Linux, root)."""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import secrets
import shutil
import socket
import subprocess
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType

WITNESS_PORT = 7598
WITNESS_SECONDS = 0.3
CLONE_NEWNET = 0x40000000  # sched.h


def unavailable_because() -> str | None:
    """Why namespaces cannot be used here, or None."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "network namespaces need the command `ip` (package iproute2)"
    tried = subprocess.run(["ip", "netns", "add", name := f"rt{os.getpid()}"], capture_output=True, text=True)
    if tried.returncode != 0:
        return f"this machine allows no network namespaces: {tried.stderr.strip()}"
    _ip("netns", "del", name)
    return None


@dataclass(frozen=True, slots=True)
class Place:
    """One namespace: its name, and the address of what runs in it."""

    namespace: str
    outer_link: str
    address: str

    def command(self, *words: str) -> list[str]:
        """The same command, to be run inside; its process id is that of the command itself."""
        return ["ip", "netns", "exec", self.namespace, *words]


class Network:
    """`size` places that reach each other and this process. Use as a context manager; leaves nothing behind."""

    def __init__(self, size: int) -> None:
        tag, third = f"{os.getpid() % 100_000}", 1 + os.getpid() % 250
        self._bridge = f"rtb{tag}"
        self._prefix = f"10.213.{third}"
        self._drops_silently = shutil.which("iptables") is not None
        self._witnesses: dict[str, socket.socket] = {}
        self.places = [
            Place(f"rt{tag}-{number}", f"rtv{tag}-{number}", f"{self._prefix}.{10 + number}") for number in range(size)
        ]

    def __enter__(self) -> Network:
        try:
            _ip("link", "add", self._bridge, "type", "bridge")
            _ip("addr", "add", f"{self._prefix}.1/24", "dev", self._bridge)
            _ip("link", "set", self._bridge, "up")
            for place in self.places:
                self._make(place)
                self._witnesses[place.namespace] = _socket_inside(place)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Take everything down; what was not made yet is passed over."""
        for witness in self._witnesses.values():
            witness.close()
        for place in self.places:
            subprocess.run(["ip", "netns", "del", place.namespace], capture_output=True, check=False)
            subprocess.run(["ip", "link", "del", place.outer_link], capture_output=True, check=False)
        subprocess.run(["ip", "link", "del", self._bridge], capture_output=True, check=False)

    def block(self, sender: Place, receiver: Place) -> None:
        """From now on nothing that `sender` sends reaches `receiver`; the other direction stays as it is."""
        if self._drops_silently:
            rule = ("INPUT", "-s", sender.address, "-j", "DROP")
            _run(receiver.command("iptables", "-C", *rule), check=False) or _run(
                receiver.command("iptables", "-A", *rule)
            )
        else:
            _run(sender.command("ip", "route", "replace", "blackhole", f"{receiver.address}/32"))

    def unblock_all(self) -> None:
        """Everything passes again."""
        for place in self.places:
            if self._drops_silently:
                _run(place.command("iptables", "-F", "INPUT"))
            else:
                _run(place.command("ip", "route", "flush", "type", "blackhole"), check=False)

    def plug(self, place: Place, *, in_: bool) -> None:
        """Pull the place's cable, or put it back in."""
        _ip("link", "set", place.outer_link, "up" if in_ else "down")

    def ways(self, places: Iterable[Place]) -> set[tuple[Place, Place]]:
        """From whom to whom a datagram arrives at this moment, of all pairs. Blocks for WITNESS_SECONDS at most."""
        tokens: dict[bytes, tuple[Place, Place]] = {}
        for sender, receiver in itertools.permutations(places, 2):
            tokens[token := secrets.token_bytes(8)] = (sender, receiver)
            with contextlib.suppress(OSError):  # the sender was told that there is no way
                self._witnesses[sender.namespace].sendto(token, (receiver.address, WITNESS_PORT))
        deadline = time.monotonic() + WITNESS_SECONDS
        arrived = set()
        for receiver in {receiver for _, receiver in tokens.values()}:
            arrived |= {tokens[token] for token in self._inbox(receiver, deadline) if token in tokens}
        return arrived

    def _inbox(self, place: Place, deadline: float) -> Iterator[bytes]:
        """What has arrived there, and what does until `deadline`."""
        inbox = self._witnesses[place.namespace]
        while True:
            inbox.settimeout(max(0.001, deadline - time.monotonic()))
            try:
                yield inbox.recv(64)
            except TimeoutError:
                return

    def _make(self, place: Place) -> None:
        inner = "eth0"
        _ip("netns", "add", place.namespace)
        _ip("link", "add", place.outer_link, "type", "veth", "peer", "name", inner, "netns", place.namespace)
        _ip("link", "set", place.outer_link, "master", self._bridge)
        _ip("link", "set", place.outer_link, "up")
        _ip("-n", place.namespace, "addr", "add", f"{place.address}/24", "dev", inner)
        for link in (inner, "lo"):
            _ip("-n", place.namespace, "link", "set", link, "up")


def _socket_inside(place: Place) -> socket.socket:
    """A socket of this process in the namespace of `place`. Only the thread that makes it goes there."""

    def make() -> socket.socket:
        descriptor = os.open(f"/run/netns/{place.namespace}", os.O_RDONLY)
        try:
            if ctypes.CDLL(None, use_errno=True).setns(descriptor, CLONE_NEWNET) != 0:
                raise OSError(ctypes.get_errno(), f"cannot enter the namespace {place.namespace}")
        finally:
            os.close(descriptor)
        witness = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        witness.bind((place.address, WITNESS_PORT))
        return witness

    with ThreadPoolExecutor(1) as thread:
        return thread.submit(make).result()


def _ip(*words: str) -> None:
    _run(["ip", *words])


def _run(command: list[str], *, check: bool = True) -> bool:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if check and done.returncode != 0:
        raise OSError(f"{' '.join(command)} failed: {done.stderr.strip()}")
    return done.returncode == 0
