"""A channel that is recorded, imported and played has the same items as before."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=2)
SEEDS = 8
US = 1000


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


def fill(draw: random.Random, channel: st.Channel) -> None:
    """Put items in any order of time, several with one time, with everything that an item may have."""
    at = channel.stats().host_time - 60 * 10**9
    for _ in range(draw.randrange(1, 60)):
        at += draw.choice([0, 0, 1, 50, 10**6]) * US
        channel.put(
            draw.randbytes(draw.choice([0, 1, 7, 300, 20_000])),
            time=at - draw.choice([0, 0, 0, 3, 40_000]) * US,
            duration=draw.choice([None, "0ns", "1ns", "7ms"]),
            attributes=draw.choice([None, {}, {"key": "value", "ä": "ö\n"}]),
            content_type=draw.choice([None, "text/plain", "application/x-note"]),
        )
        if draw.random() < 0.1:
            channel.advance(at - 10**9)


def facts(channel: st.Channel) -> tuple[list[tuple[object, ...]], int | None]:
    """The items in the order of their acceptance, and the advance."""
    items = sorted(channel.get(st.OLDEST, st.NOW), key=lambda one: one.seq)
    shown = [(one.time, one.duration, one.end, one.payload, one.attributes, one.content_type) for one in items]
    return shown, channel.stats().advance


@pytest.mark.parametrize("seed", range(SEEDS))
def test_a_channel_that_is_recorded_imported_and_played_has_the_same_items(
    rt: st.Connection, tmp_path: Path, seed: int
) -> None:
    name = f"trip/{seed}"
    source = rt.channel(name, max_age="1h")
    fill(random.Random(seed), source)
    with rt.record(source, tmp_path / "first.mcap", since="1h") as recorder:
        pass
    assert recorder.summary is not None
    assert recorder.summary.complete
    for made in ("imported/", "played/"):
        rt.channel(f"{made}{name}", max_age="1h")
    imported = rt.import_file(tmp_path / "first.mcap", "imported/").wait()
    played = rt.replay_file(tmp_path / "first.mcap", "played/", speed=0).wait()
    for summary in (imported, played):
        assert summary is not None
        assert summary.complete
    assert facts(rt.channel(f"imported/{name}")) == facts(rt.channel(f"played/{name}")) == facts(source)
