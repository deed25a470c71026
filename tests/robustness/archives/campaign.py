"""Injects faults into a host with an archive, while programs put with ack="disk", and then looks for each acked item.

The archive is on a disk of its own, a small tmpfs. The seed decides the order of the faults and all choices.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.robustness.archives.putting import PAYLOAD_BYTES, NumberProducer

PROGRAMS = 2
ACKS_BETWEEN = 30
REFUSALS = 3
READS_MAX = 10
BLOCK_ITEMS_MAX = 2**18 // PAYLOAD_BYTES + 1
RESTART_SECONDS_MAX = 180.0


@dataclass
class Findings:
    """The findings of a campaign. `lost`: the acknowledged payloads that the last read does not find."""

    faults: Counter[str] = field(default_factory=Counter)
    acked: int = 0
    refused: int = 0
    lost: list[bytes] = field(default_factory=list)
    hidden_by_flips: int = 0


class Campaign:
    """One campaign over one recorded channel of a running cluster with one host, whose archive is in `disk`."""

    def __init__(self, cluster: LocalCluster, rt: st.Connection, disk: Path, seed: int) -> None:
        self.findings = Findings()
        self._host, self._rt, self._disk = cluster.hosts[0], rt, disk
        self._random = random.Random(seed)
        self._channel = rt.channel(f"campaign/{seed}", max_items=40, archive="forever")
        self._began = self._channel.stats().host_time
        self._programs: list[NumberProducer] = []
        self._begun = 0
        self._acked: set[bytes] = set()

    def run(self, faults: list[str]) -> Findings:
        """Inject the faults, in this order, and return the findings."""
        inject: dict[str, Callable[[], None]] = {
            "kill": self.kill,
            "stop": self.stop,
            "full disk": self.full_disk,
            "flipped bit": self.flipped_bit,
        }
        for fault in faults:
            with self._putting():
                self._acks()
                inject[fault]()
                self._acks()
            self.findings.faults[fault] += 1
        found = _numbers(self._items())
        self.findings.acked = len(self._acked)
        self.findings.lost = sorted(self._acked - found)
        return self.findings

    @contextmanager
    def _putting(self) -> Iterator[None]:
        self._programs = [NumberProducer(self._channel, self._number()) for _ in range(PROGRAMS)]
        try:
            yield
        finally:
            for program in self._programs:
                program.stop()
                self._acked.update(program.acked)
                self.findings.refused += program.refused

    def _number(self) -> int:
        """The first number for the payloads of a new program. No two programs put the same number."""
        self._begun += 1
        return self._begun * 10**6

    def _acks(self) -> None:
        for program in self._programs[-PROGRAMS:]:
            program.wait_for_acks(ACKS_BETWEEN)

    def _items(self) -> st.Items:
        """All items. A busy machine may need several tries, because the host has just started."""
        for _ in range(READS_MAX - 1):
            with suppress(st.DeadlineExceeded, st.Unavailable):
                return self._channel.get(self._began, st.NEWEST)
        return self._channel.get(self._began, st.NEWEST)

    def kill(self) -> None:
        """Kill the host, and start it again."""
        self._host.kill()
        self._host.restart(RESTART_SECONDS_MAX)

    def stop(self) -> None:
        """Stop the host cleanly, and start it again. The incarnation must stay the same."""
        before = self._items().incarnation
        self._host.stop()
        self._host.restart(RESTART_SECONDS_MAX)
        assert self._items().incarnation == before, "a clean stop keeps the incarnation"

    def full_disk(self) -> None:
        """Fill the disk until the host refuses puts, and sometimes kill the host then. Afterwards make room again."""
        ballast = self._disk / "ballast"
        with ballast.open("wb", buffering=0) as file, suppress(OSError):
            while file.write(b"\0" * 4096):
                pass
        for program in self._programs:
            program.wait_for_refusals(REFUSALS)
        if self._random.random() < 0.5:
            self._host.kill()
            ballast.unlink()
            self._host.restart(RESTART_SECONDS_MAX)
        else:
            ballast.unlink()

    def flipped_bit(self) -> None:
        """Flip a bit of a file while the host is stopped. A read may then lack the items of one block, and must say so.

        Afterwards restore the file, so that the last read of the campaign finds all items.
        """
        for program in self._programs:
            program.stop()
        acked = self._acked.union(*(one.acked for one in self._programs))
        self._host.stop()
        path = self._random.choice(sorted(self._disk.rglob("*.segment")))
        former = path.read_bytes()
        path.write_bytes(self._flipped(former))
        self._host.restart(RESTART_SECONDS_MAX)
        items = self._items()
        missing = acked - _numbers(items)
        # COLLECTED: the head of the first block is damaged, so that the host does not know that the block existed
        assert not missing or items.reason in ("LOST", "COLLECTED"), (len(missing), items.reason)
        assert len(missing) <= BLOCK_ITEMS_MAX, len(missing)
        self.findings.hidden_by_flips += len(missing)
        self._host.stop()
        path.write_bytes(former)
        self._host.restart(RESTART_SECONDS_MAX)
        self._programs += [NumberProducer(self._channel, self._number()) for _ in range(PROGRAMS)]

    def _flipped(self, former: bytes) -> bytes:
        flipped = bytearray(former)
        flipped[self._random.randrange(len(flipped))] ^= 1 << self._random.randrange(8)
        return bytes(flipped)


def _numbers(items: st.Items) -> set[bytes]:
    return {item.payload.split(b" ")[0] for item in items}


def in_rounds(rounds: int, seed: int) -> list[str]:
    """All faults of `rounds` rounds. Each round has an order of its own, and kills twice."""
    order = random.Random(seed)
    faults: list[str] = []
    for _ in range(rounds):
        one = ["kill", "stop", "full disk", "kill", "flipped bit"]
        order.shuffle(one)
        faults += one
    return faults
