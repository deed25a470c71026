"""The campaign of archives: `python -m tests.robustness.archives --rounds 10 --seed 1`. Needs root."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import stampede_rt as st
from tests.robustness.archives.campaign import Campaign, in_rounds
from tests.support.channel_host.small_disk import NoSmallDisk, small_disk
from tests.support.cluster import running_cluster

DISK_BYTES = 64 * 2**20


def main() -> int:
    """Run the campaign, and print its findings. Returns 1 if an acked item is lost, 2 if this machine cannot run it."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness.archives", description=__doc__)
    parser.add_argument("--rounds", type=int, default=10, help="the number of injections of each fault")
    parser.add_argument("--seed", type=int, default=1, help="decides the order of the faults and all choices")
    wanted = parser.parse_args()
    began = time.monotonic()
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            small_disk(Path(folder), DISK_BYTES) as disk,
            running_cluster(hosts=1, supernodes=1, archive=disk) as cluster,
            st.connect(cluster.address) as rt,
        ):
            found = Campaign(cluster, rt, disk, wanted.seed).run(in_rounds(wanted.rounds, wanted.seed))
    except NoSmallDisk as error:
        print(f"cannot run: {error}", file=sys.stderr)
        return 2
    for fault, count in sorted(found.faults.items()):
        print(f"{fault:12} {count:4}")
    print(f"{found.acked} puts acknowledged, {len(found.lost)} lost; {found.refused} refused because the disk was full")
    print(f"{found.hidden_by_flips} items were missing while a bit of an archive file was flipped")
    print(f"took {time.monotonic() - began:.0f} s")
    return 1 if found.lost else 0


if __name__ == "__main__":
    sys.exit(main())
