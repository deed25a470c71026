"""Puts per second on many channels of a machine whose hosts are one process, or several: `stampede host --processes`.

Two producer processes put items of 64 B, each on several channels with a thread for each, and wait for each ack. The
cases take turns, so that other work on the machine affects all of them. Clients and hosts share the cores.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.processes import started

PRODUCERS, CHANNELS_EACH = 2, 4
PAYLOAD = bytes(64)


def produce(url: str, secret: str, prefix: str, seconds: float) -> float:
    """Put on CHANNELS_EACH channels for `seconds`. Returns the acknowledged puts per second."""
    done = [0] * CHANNELS_EACH
    with st.connect(url, secret=Path(secret)) as rt:
        channels = [rt.channel(f"{prefix}/{number}", max_items=1000) for number in range(CHANNELS_EACH)]
        end = time.monotonic() + seconds

        def put(number: int) -> None:
            while time.monotonic() < end:
                channels[number].put(PAYLOAD)
                done[number] += 1

        threads = [threading.Thread(target=put, args=(number,)) for number in range(CHANNELS_EACH)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return sum(done) / seconds


def measure(processes: int, seconds: float) -> float:
    """The puts per second of all producers with this number of host processes."""
    with LocalCluster(hosts=0, supernodes=1, durable=False, log_level="warning") as cluster:
        secret = str(cluster.secret.path)
        own = ["--name", "h", "--listen", "localhost:0", "--frontend", cluster.address, "--secret-file", secret]
        host = [sys.executable, "-m", "stampede_rt_channel_host", "--processes", str(processes), *own]
        with started(host) as running:
            assert running.stdout is not None
            for _ in range(processes):
                running.stdout.readline()
            this = [sys.executable, "-m", "tests.benchmarks.host_processes", "--seconds", str(seconds), "--producer"]
            commands = [[*this, cluster.address, secret, f"p{number}"] for number in range(PRODUCERS)]
            producers = [subprocess.Popen(one, stdout=subprocess.PIPE, text=True) for one in commands]
            return sum(float(one.communicate(timeout=seconds + 60)[0]) for one in producers)


def main() -> None:
    """Print the median of the runs of each case, and the ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--producer", nargs=3, metavar=("URL", "SECRET", "PREFIX"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.producer:
        url, secret, prefix = arguments.producer
        print(produce(url, secret, prefix, arguments.seconds))
        return
    found: dict[int, list[float]] = {1: [], arguments.processes: []}
    for _ in range(arguments.runs):
        for processes, rates in found.items():
            rates.append(measure(processes, arguments.seconds))
    for processes, rates in found.items():
        print(f"{processes} processes: {statistics.median(rates):.0f} puts/s, {[round(one) for one in rates]}")


if __name__ == "__main__":
    main()
