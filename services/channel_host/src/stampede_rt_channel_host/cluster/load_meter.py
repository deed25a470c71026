"""Measures the load of this host for its reports to the directory."""

from __future__ import annotations

import time
from collections.abc import Callable

from stampede_rt.transports.machine import machine_id
from stampede_rt.v1 import directory_pb2

PERMILLE_MAX = 1_000_000


class LoadMeter:
    """Measures the load between one call of `measure` and the next. Use it on one thread.

    `held_bytes` gives the bytes that are held now; the limit is `bytes_max`.
    """

    def __init__(
        self,
        held_bytes: Callable[[], int],
        bytes_max: int,
        *,
        cpu_nanos: Callable[[], int] = time.process_time_ns,
        steady_nanos: Callable[[], int] = time.monotonic_ns,
        has_archive: bool = False,
        is_private: bool = False,
    ) -> None:
        """`has_archive`: the host can record channels. `is_private`: see HostIdentity."""
        self._facts = directory_pb2.HostLoad(has_archive=has_archive, private=is_private, machine=machine_id())
        self._held_bytes = held_bytes
        self._bytes_max = bytes_max
        self._cpu_nanos = cpu_nanos
        self._steady_nanos = steady_nanos
        self._last = cpu_nanos(), steady_nanos()

    def measure(self) -> directory_pb2.HostLoad:
        """The load since the last call: the share of a core that the process used, and the memory."""
        now = self._cpu_nanos(), self._steady_nanos()
        used, passed = now[0] - self._last[0], now[1] - self._last[1]
        self._last = now
        load = directory_pb2.HostLoad(
            busy_permille=min(max(0, used) * 1000 // max(1, passed), PERMILLE_MAX),
            held_bytes=max(0, self._held_bytes()),
            bytes_max=self._bytes_max,
        )
        load.MergeFrom(self._facts)
        return load
