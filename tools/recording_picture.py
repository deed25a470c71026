"""Draws the picture of docs/recording.md from a recorded channel: `.venv/bin/python tools/recording_picture.py`.

It starts a cluster with an archive. The drawn items were put into a channel and read back from it.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tools.time_pictures import BLUE, GREEN, IMAGES, MS, ORANGE, SECOND, Lane, Picture, draw, drawn

ITEMS, HELD = 10, 4
WAIT_SECONDS = 20.0
NAME = "recording-one-read.png"


def one_read(rt: st.Connection) -> Picture:
    """Put items, and read them from the archive and from memory. Memory keeps only the last HELD items."""
    channel = rt.channel(f"pictures/recorded-{st.now()}", max_items=HELD, archive="7d")
    base = st.now() - 10 * SECOND
    for number in range(ITEMS):
        channel.put(b"%d" % number, time=base + number * 900 * MS)
    until = time.monotonic() + WAIT_SECONDS
    while channel.stats().held > HELD and time.monotonic() < until:
        time.sleep(0.05)  # until the archive has the items that leave memory
    now = base + 9 * SECOND
    whole = channel.get(st.OLDEST, now)
    memory = channel.get(st.OLDEST, now, within="memory")
    found = channel.get(base + 2_900 * MS, base + 7_000 * MS)
    held = {item.seq for item in memory}
    archived = [item for item in whole if item.seq not in held]
    numbers = ", ".join((item.payload or b"").decode() for item in found)
    return Picture(
        "One read over archive and memory",
        "The span of the last archived item ends where the first item in memory begins. The reader sees no border.",
        [
            Lane("archive", BLUE, drawn(archived, base)),
            Lane("memory", ORANGE, drawn(memory, base)),
            Lane("one get", GREEN, drawn(found, base)),
        ],
        now_s=9.0,
        start_s=-0.3,
        end_s=9.9,
        window_s=(2.9, 7.0, f"get(2.9 s, 7 s): {numbers}"),
    )


def main() -> None:
    """Draw into docs/images."""
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
        LocalCluster(hosts=1, supernodes=1, archive=Path(folder)) as cluster,
    ):
        os.environ["STAMPEDE_SECRET_FILE"] = str(cluster.secret_file)
        with st.connect(cluster.address) as rt:
            draw(one_read(rt), IMAGES / NAME)


if __name__ == "__main__":
    main()
