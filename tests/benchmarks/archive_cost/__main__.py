"""The cost of recorded channels compared with a plain writer and two other systems.

    python -m tests.benchmarks.archive_cost

All figures are from one run on this machine, with the files in the folder of --folder. The figures of writers and of
live readers are medians of --rounds rounds, with the least and the greatest value. In each round all writers write, one
after the other. The whole command takes about five minutes. The part `files` reads the files of archives of up to
--files items in this process, without a host: 10^8 items of 64 B need 9 GB, and some minutes more.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import stampede_rt as st
from tests.benchmarks.archive_cost.files import reading_files
from tests.benchmarks.archive_cost.live import living
from tests.benchmarks.archive_cost.reading import reading
from tests.benchmarks.archive_cost.writing import writing
from tests.support.cluster import running_cluster

PARTS = ("writing", "live", "reading", "files")


def main() -> None:
    """Print the tables of the wanted parts."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.archive_cost", description=__doc__)
    parser.add_argument(
        "--folder", type=Path, help="a folder on the measured disk; default: the folder for temporary files"
    )
    parser.add_argument("--only", choices=PARTS, help="measure only this part; default: all parts")
    parser.add_argument("--rounds", type=int, default=3, help="the rounds of writers and of live readers")
    parser.add_argument(
        "--largest", type=int, default=10**7, help="the items of the largest archive that is read through a host"
    )
    parser.add_argument("--files", type=int, default=10**7, help="the items of the largest archive in `files`")
    wanted = parser.parse_args()
    parts = (wanted.only,) if wanted.only else PARTS
    print(f"load average at the start: {os.getloadavg()[0]:.1f}, {os.cpu_count()} processors")
    with tempfile.TemporaryDirectory(dir=wanted.folder, prefix="archive-cost-", ignore_cleanup_errors=True) as folder:
        place = Path(folder)
        with (
            running_cluster(hosts=1, supernodes=1, archive=place / "archive") as cluster,
            st.connect(cluster.address) as rt,
        ):
            if "writing" in parts:
                with st.host(cluster.address, archive=place / "here", drain="0s", private=True) as here:
                    writing(rt, here, place, wanted.rounds)
            if "live" in parts:
                living(rt, cluster.address, wanted.rounds)
            if "reading" in parts:
                reading(rt, wanted.largest)
        if "files" in parts:
            reading_files(place / "files", wanted.files)
    print(f"\nload average at the end: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
