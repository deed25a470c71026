"""Simulated machines: network namespaces on a bridge, each with its own address (Linux, root, iproute2)."""

from __future__ import annotations

import ctypes
import os
import secrets
import shutil
import subprocess
from dataclasses import dataclass
from ipaddress import IPv4Network
from types import TracebackType
from typing import Self

CLONE_NEWNET = 0x40000000  # sched.h
NETWORKS = IPv4Network("198.18.0.0/15")  # reserved for tests (RFC 2544), so no other machine has such an address
PREFIX_BITS, NAMESPACES_MAX = 27, 29
NETWORKS_MAX = 1 << PREFIX_BITS - NETWORKS.prefixlen


def unavailable_because() -> str | None:
    """Return why namespaces cannot be used here; None if they can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if shutil.which("ip") is None:
        return "network namespaces need the command `ip` (package iproute2)"
    tried = subprocess.run(["ip", "netns", "add", name := f"rt{secrets.token_hex(4)}"], capture_output=True, text=True)
    if tried.returncode != 0:
        return f"this machine allows no network namespaces: {tried.stderr.strip()}"
    ip("netns", "del", name)
    return None


@dataclass(frozen=True, slots=True)
class NetworkNamespace:
    """One namespace: its name, and the address of the processes in it."""

    name: str
    outer_link: str
    address: str

    def command(self, *words: str) -> list[str]:
        """Return the command that runs `words` inside. Its process becomes that of `words`, with the same id."""
        return ["ip", "netns", "exec", self.name, *words]

    def enter(self) -> None:
        """Move the calling thread, and the threads that it starts later, into the namespace.

        Earlier sockets stay outside.
        """
        descriptor = os.open(f"/run/netns/{self.name}", os.O_RDONLY)
        try:
            if ctypes.CDLL(None, use_errno=True).setns(descriptor, CLONE_NEWNET) != 0:
                raise OSError(ctypes.get_errno(), f"cannot enter the namespace {self.name}")
        finally:
            os.close(descriptor)


class NamespaceNetwork:
    """`size` namespaces that reach each other and this process. A context manager, which removes all of them.

    `address` is the address of this process on the bridge. There may be NAMESPACES_MAX namespaces. Their names and
    addresses are chosen when the context begins. Two networks never share a bridge, because its name is unique in the
    kernel.
    """

    def __init__(self, size: int) -> None:
        if size > NAMESPACES_MAX:
            raise ValueError(f"a network has at most {NAMESPACES_MAX} namespaces, and not {size}")
        self._size, self._is_made = size, False
        self._choose(os.getpid() % NETWORKS_MAX)

    def _choose(self, network: int) -> None:
        self._bridge = f"rtb{network}"
        first = NETWORKS[network << 32 - PREFIX_BITS] + 1
        self.address = str(first)
        self.namespaces = [
            NetworkNamespace(f"rt{network}-{number}", f"rtv{network}-{number}", str(first + 1 + number))
            for number in range(self._size)
        ]

    def _claim(self) -> None:
        """Make the bridge of the first free network. Raises OSError."""
        for step in range(NETWORKS_MAX):
            self._choose((os.getpid() + step) % NETWORKS_MAX)
            command = ["ip", "link", "add", self._bridge, "type", "bridge"]
            tried = subprocess.run(command, capture_output=True, text=True, check=False)
            self._is_made = tried.returncode == 0
            if self._is_made:
                return
            if "exists" not in tried.stderr:
                raise OSError(f"{' '.join(command)} failed: {tried.stderr.strip()}")
        raise OSError(
            f"all {NETWORKS_MAX} networks are taken; remove the bridges that killed processes left, rtb0 and on"
        )

    def __enter__(self) -> Self:
        self._claim()
        try:
            ip("addr", "add", f"{self.address}/{PREFIX_BITS}", "dev", self._bridge)
            ip("link", "set", self._bridge, "up")
            for namespace in self.namespaces:
                self._make(namespace)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Remove the namespaces and the bridge."""
        if not self._is_made:
            return
        for namespace in self.namespaces:
            subprocess.run(["ip", "netns", "del", namespace.name], capture_output=True, check=False)
            subprocess.run(["ip", "link", "del", namespace.outer_link], capture_output=True, check=False)
        subprocess.run(["ip", "link", "del", self._bridge], capture_output=True, check=False)

    def _make(self, namespace: NetworkNamespace) -> None:
        inner = "eth0"
        ip("netns", "add", namespace.name)
        ip("link", "add", namespace.outer_link, "type", "veth", "peer", "name", inner, "netns", namespace.name)
        ip("link", "set", namespace.outer_link, "master", self._bridge)
        ip("link", "set", namespace.outer_link, "up")
        ip("-n", namespace.name, "addr", "add", f"{namespace.address}/{PREFIX_BITS}", "dev", inner)
        for link in (inner, "lo"):
            ip("-n", namespace.name, "link", "set", link, "up")


def ip(*words: str) -> None:
    """Run `ip`. If it fails, raises OSError with its output."""
    run(["ip", *words])


def run(command: list[str], *, check: bool = True) -> bool:
    """Run a command. Returns whether it succeeded; with `check`, raises OSError with its output if it failed."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if check and done.returncode != 0:
        raise OSError(f"{' '.join(command)} failed: {done.stderr.strip()}")
    return done.returncode == 0
