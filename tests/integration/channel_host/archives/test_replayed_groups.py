"""Groups of recorded channels under a virtual clock: their answers lead to no live channel."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import recorded_cluster_fixture

MS, SECOND = 10**6, 10**9

cluster = recorded_cluster_fixture()


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


READS: dict[str, Callable[[Any, int], Any]] = {
    "get": lambda group, _: group.get(st.OLDEST, st.NOW),
    "get as of": lambda group, past: group.get(st.OLDEST, st.NOW, as_of=past),
    "newest": lambda group, _: group.newest(),
    "newest as of": lambda group, past: group.newest(as_of=past),
    "reasons": lambda group, _: group.newest().reasons,
    "match": lambda group, _: next(group.match(group.channels[0], "1ms", start=st.OLDEST)),
    "match as of": lambda group, past: next(group.match(group.channels[0], "1ms", start=st.OLDEST, as_of=past)),
    "member as of": lambda group, past: {one: group[one].get(st.OLDEST, st.NOW, as_of=past) for one in group.channels},
}


@pytest.mark.parametrize("read", READS)
def test_an_answer_of_a_replayed_group_has_replayed_channels_and_a_closed_replay_gives_none(
    rt: st.Connection, read: str
) -> None:
    left, right = (rt.channel(f"{read}/{side}".replace(" ", "-"), max_age="60s", archive="7d") for side in "lr")
    rt.group(read.replace(" ", "-"), [left, right])
    began = left.stats().host_time - SECOND
    for number in range(0 if read == "reasons" else 3):
        for channel in (left, right):
            channel.put(b"then", time=began + number * MS)
    start = left.stats().host_time
    left.put(b"now")
    replay = rt.replay(start, speed=0)
    group = replay.group(read.replace(" ", "-"))
    answer = READS[read](group, start)
    assert next(iter(answer)) == replay.channel(left.name)
    if read != "reasons":
        assert [channel.newest().payload for channel in answer] == [b"then"] * len(answer)
    assert group == replay.group(group.name)
    replay.close()
    with pytest.raises(st.Unavailable, match="this replay, or its connection, is closed"):
        READS[read](group, start)
