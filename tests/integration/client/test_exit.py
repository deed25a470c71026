"""Scripts that end while they still hold streams: the interpreter exits, as it does without the client."""

from __future__ import annotations

import subprocess
import sys

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)

BEGIN = """
import sys
import stampede_rt as st
rt = st.connect(sys.argv[1], name="exit/" + sys.argv[2])
channel = rt.channel("exit/" + sys.argv[2], max_age="60s")
channel.put(b"0")
group = rt.group("exit/" + sys.argv[2], [channel])
"""
READS = {
    "subscription": "stream = channel.subscribe(start=st.OLDEST); next(stream)",
    "newest": "stream = channel.subscribe(start=st.OLDEST, mode='newest'); next(stream)",
    "group": "channel.put(b'1'); stream = group[channel].subscribe(start=st.OLDEST); next(stream)",
    "cuts": "stream = group.subscribe(); channel.put(b'1'); channel.put(b'2'); next(stream)",
    "matches": "stream = group.match(per=channel, tolerance='1ms'); channel.put(b'1'); channel.put(b'2'); next(stream)",
    "peers": (
        "stream = rt.watch_peers().__enter__(); "
        "st.connect(sys.argv[1], name='exit/other/' + sys.argv[2]).close(); next(stream)"
    ),
    "queue": "jobs = rt.queue('exit/jobs'); jobs.put(b'0'); stream = iter(jobs); next(stream).ack()",
}
ENDS = {"open": "", "closed": "\nrt.close()", "failed": "\nraise SystemExit(3)"}


@pytest.mark.parametrize("read", READS)
def test_a_script_that_still_holds_a_stream_ends(cluster: LocalCluster, read: str) -> None:
    started = [
        subprocess.Popen([sys.executable, "-c", BEGIN + READS[read] + end, cluster.address, f"{read}-{how}"])
        for how, end in ENDS.items()
    ]
    try:
        assert [one.wait(30) for one in started] == [0, 0, 3]
    finally:
        for one in started:
            one.kill()
            one.wait()
