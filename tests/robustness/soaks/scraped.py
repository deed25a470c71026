"""A soak of the metrics: `python -m tests.robustness.soaks.scraped --minutes 10` (also `make soak-metrics`).

A Prometheus scrapes a real cluster each second, while programs put and read, and each part in turn is killed with
SIGKILL and started again. The soak fails unless every part is scraped again within seconds of its start, the
scrapes of running parts are short, and no process has grown. Needs Debian's prometheus.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import tempfile
import time
from pathlib import Path

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.support.prometheus import Prometheus

CHANNELS = 20
BACK_SECONDS_MAX = 60.0
SCRAPE_SECONDS_MAX = 0.5
"""The limit for 99 % of the scrapes of a running part."""
GROWTH_BYTES_MAX = 96 * 2**20
PUT_PERIOD_SECONDS = 0.02


async def put_forever(address: str, secret: Path, number: int) -> None:
    """Put into one channel, and read its newest item, until cancelled. Goes on after each error."""
    async with aio.connect(address, secret=secret) as rt:
        while True:
            with contextlib.suppress(st.StampedeError):
                channel = await rt.channel(f"soak/{number}", max_items=100)
                while True:
                    await channel.put(bytes(200), timeout=1)
                    await channel.newest()
                    await asyncio.sleep(PUT_PERIOD_SECONDS)
            await asyncio.sleep(PUT_PERIOD_SECONDS)


async def kill_each(cluster: LocalCluster, prometheus: Prometheus, until_s: float) -> list[tuple[str, float]]:
    """Kill the parts in turn. Returns for each kill the part, and the seconds until it was scraped and ready again."""
    done: list[tuple[str, float]] = []
    for process in itertools.cycle([*cluster.supernodes, *cluster.hosts, *cluster.frontends]):
        if time.monotonic() >= until_s:
            return done
        done.append((process.name, await asyncio.to_thread(_kill, process, prometheus)))
    return done


def _kill(process: ServiceProcess, prometheus: Prometheus) -> float:
    process.kill()
    up = f'up{{part="{process.name}"}}'
    prometheus.until(up, lambda values: values == [0.0])
    process.start()
    process.wait_ready(BACK_SECONDS_MAX)
    began_s = time.monotonic()
    prometheus.until(f"{up} * on(instance) stampede_ready", lambda values: values == [1.0])
    return time.monotonic() - began_s


def complaints(prometheus: Prometheus, minutes: float, kills: list[tuple[str, float]]) -> list[str]:
    """The errors after the soak."""
    window = f"[{_window(minutes)}]"
    found = [f"{name} was back after {seconds:.1f} s" for name, seconds in kills if seconds > BACK_SECONDS_MAX]
    running_seconds = f"(scrape_duration_seconds and on(instance) up == 1){window[:-1]}:1s]"
    slow = prometheus.ask(f"quantile_over_time(0.99, {running_seconds})")
    found += [f"scrapes of {labels['part']} take {value:.2f} s" for labels, value in slow if value > SCRAPE_SECONDS_MAX]
    grown = prometheus.ask(f"max_over_time(process_resident_memory_bytes{window})")
    found += [
        f"{labels['part']} has {value / 2**20:.0f} MiB" for labels, value in grown if value > _most(labels["part"])
    ]
    accepted = prometheus.ask(f"sum(increase(stampede_items_accepted_total{window}))")
    if not accepted or accepted[0][1] < 100:
        found.append("fewer than 100 items were counted")
    return found


def _window(minutes: float) -> str:
    return f"{max(1, round(minutes))}m"


def _most(part: str) -> float:
    return GROWTH_BYTES_MAX + (90 if part.startswith("supernode") else 80) * 2**20


async def soak(minutes: float) -> int:
    """Run the soak. Returns the exit status."""
    with (
        tempfile.TemporaryDirectory(prefix="scraped-") as folder,
        LocalCluster(hosts=2, supernodes=3, metrics="localhost:0", log_level="error") as cluster,
    ):
        prometheus = Prometheus(cluster, Path(folder))
        try:
            return await _soak(cluster, prometheus, minutes)
        finally:
            prometheus.stop()


async def _soak(cluster: LocalCluster, prometheus: Prometheus, minutes: float) -> int:
    until_s = time.monotonic() + 60 * minutes
    putting = [asyncio.create_task(put_forever(cluster.address, cluster.secret_file, one)) for one in range(CHANNELS)]
    try:
        everybody = float(len(cluster.metrics))
        await asyncio.to_thread(prometheus.until, 'sum(up{job="stampede"})', lambda values: values == [everybody])
        kills = await kill_each(cluster, prometheus, until_s)
    finally:
        for one in putting:
            one.cancel()
        ended = await asyncio.gather(*putting, return_exceptions=True)
    wrong = complaints(prometheus, minutes, kills)
    wrong += [f"a program failed: {one!r}" for one in ended if not isinstance(one, asyncio.CancelledError)]
    slowest = max(seconds for _, seconds in kills)
    accepted = prometheus.ask("sum(stampede_items_accepted_total)")[0][1]
    print(f"{len(kills)} kills; ready in the metrics {slowest:.1f} s after the start at most")
    print(f"{accepted:.0f} items counted by the hosts that run now")
    for line in wrong:
        print(f"WRONG: {line}")
    return 1 if wrong else 0


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness.soaks.scraped", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="the time for which parts are killed")
    return asyncio.run(soak(parser.parse_args().minutes))


if __name__ == "__main__":
    raise SystemExit(main())
