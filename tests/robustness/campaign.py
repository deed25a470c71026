"""Faults one after the other on a cluster that is in use; then the histories are judged."""

from __future__ import annotations

import asyncio
import itertools
import random
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.robustness import faults, hostility
from tests.robustness.callers import Caller, HostActor, Probe, with_background
from tests.robustness.cluster import Cluster, running_cluster
from tests.robustness.histories.channel_model import acknowledged_writes, check_channel_histories
from tests.robustness.histories.operations import Operation, Recorder
from tests.robustness.scene import Fault, Outcome, Scene

EVERY_FAULT: dict[str, Fault] = {**faults.FAULTS, **hostility.FAULTS}
CALLERS, HOSTS = 6, 3
SMALL_DISK = "size=48m"
# (delay, jitter, share of chunks that are retransmitted, share at which the connection is reset)
WEATHERS = {
    "delay of 50 to 100 ms": (0.05, 0.05, 0.0, 0.0),
    "delay of 250 to 500 ms": (0.25, 0.25, 0.0, 0.0),
    "1 % loss": (0.002, 0.01, 0.01, 0.0),
    "20 % loss": (0.002, 0.01, 0.2, 0.0),
    "reset connections and delays that overtake": (0.0, 0.3, 0.02, 0.01),
}


@dataclass(frozen=True, slots=True)
class Findings:
    """What came of one campaign. All of it was judged; a violation would have been raised."""

    outcomes: list[Outcome]
    operations: list[Operation]
    names: int
    not_done: int
    renewals: int
    registrations: int
    gap_s: float  # the longest time without an acknowledged write while a majority was alive and connected
    gap_in: str
    seconds: float

    @property
    def acknowledged(self) -> int:
        return acknowledged_writes(self.operations)


async def run_campaign(folder: Path, names: Sequence[str], *, seed: int, quiet_s: float = 1.0) -> Findings:
    """Faults by name, in this order, each followed by `quiet_s` in which everybody serves again.

    Raises NotLinearizable, TwoOwners, or TimeoutError if the directory does not come back.
    """
    with small_disk(folder / "s3"):
        async with running_cluster(folder) as cluster:
            campaign = _Campaign(cluster, folder, seed)

            async def body() -> None:
                for name in names:
                    await campaign.attempt(name)
                    await asyncio.sleep(quiet_s)

            return await campaign.run(body)


async def run_weathers(folder: Path, *, seed: int, each_s: float) -> Findings:
    """Every kind of bad network, with a kill -9 of the leader in the middle of each."""
    async with running_cluster(folder, relayed=True) as cluster:
        campaign = _Campaign(cluster, folder, seed)

        async def body() -> None:
            for kind, figures in WEATHERS.items():
                began = time.monotonic()
                for one in cluster.supernodes:
                    one.set_weather(*figures)
                await asyncio.sleep(each_s / 2)
                victim = await cluster.leader()
                await victim.kill()
                await victim.start()
                await asyncio.sleep(each_s / 2)
                for one in cluster.supernodes:
                    one.set_weather(0, 0, 0, 0)
                await cluster.all_serve()
                campaign.scene.ended(f"relay: {kind}, and kill -9 of the leader", began, majority=False)

        return await campaign.run(body)


class _Campaign:
    """The callers, hosts and probe around a cluster, and what they find."""

    def __init__(self, cluster: Cluster, folder: Path, seed: int) -> None:
        self._cluster = cluster
        self._recorder = Recorder(time.monotonic)
        self._hosts = [HostActor(number, cluster, seed) for number in range(HOSTS)]
        self._callers = [Caller(number, cluster, self._recorder, self._hosts, seed) for number in range(CALLERS)]
        self._probe = Probe(cluster)
        self.scene = Scene(cluster, self._probe, random.Random(seed), folder)

    async def attempt(self, name: str) -> None:
        """One fault; that the directory did not come back in time is noted, and fails the campaign at its end."""
        began = time.monotonic()
        try:
            await EVERY_FAULT[name](self.scene)
            for one in self._cluster.supernodes:
                if not one.running:
                    raise TimeoutError(f"{one.name} has ended: {one.last_words()!r}")
            await self._cluster.all_serve()
        except TimeoutError as error:
            self.scene.ended(name, began, majority=False, note=f"did not come back in time: {error}", failed=True)
            await asyncio.gather(*(one.start() for one in self._cluster.supernodes if not one.running))

    async def run(self, body: object) -> Findings:
        """Run `body` with everything around it, then judge. Raises what was found."""
        assert callable(body)
        began = time.monotonic()
        work = [*(host.run() for host in self._hosts), *(caller.run(began) for caller in self._callers)]
        await with_background([*work, self._probe.run()], body)
        operations = self._recorder.operations
        names = await asyncio.to_thread(check_channel_histories, operations)
        gap_s, moment = longest_gap(self._probe.served, self.scene.outcomes)
        return Findings(
            self.scene.outcomes,
            operations,
            names,
            sum(caller.not_done for caller in self._callers),
            sum(host.renewals for host in self._hosts),
            sum(host.registrations for host in self._hosts),
            gap_s,
            next((one.kind for one in self.scene.outcomes if one.began - 1 <= moment <= one.ended + 1), "no fault"),
            time.monotonic() - began,
        )


def longest_gap(served: Sequence[tuple[float, float]], outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """The longest time between two acknowledged writes, without the times when no majority could be had; and when."""
    times = sorted(answered for _, answered in served)
    without = [(one.began, one.ended) for one in outcomes if not one.majority]
    gaps = [
        (later - earlier, earlier)
        for earlier, later in itertools.pairwise(times)
        if not any(earlier < end and begin < later for begin, end in without)
    ]
    return max(gaps, default=(0.0, 0.0))


@contextmanager
def small_disk(folder: Path) -> Iterator[None]:
    """A file system of its own under `folder`, small enough to be filled."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", SMALL_DISK, "robustness", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
