"""A step of a channel host's clock by an hour: the test moves the clock of the host."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import pytest

import stampede_rt as st
from tests.support.channel_host.loopback_host import LoopbackHost, loopback_host

pytestmark = pytest.mark.without_rules("its services know no rules")
SECOND = 10**9
HOUR = 3_600 * SECOND
STEPS = pytest.mark.parametrize("step", [HOUR, -HOUR], ids=["on", "back"])


@pytest.fixture(scope="module")
def host() -> Iterator[LoopbackHost]:
    with loopback_host() as running:
        yield running


@pytest.fixture
def rt(host: LoopbackHost) -> Iterator[st.Connection]:
    host.settle_wall_clock()
    with st.connect(host.frontend) as connection:
        yield connection


@STEPS
def test_a_stepped_wall_clock_does_not_empty_a_window(
    host: LoopbackHost, rt: st.Connection, step: int, request: pytest.FixtureRequest
) -> None:
    channel = rt.channel(f"window/{request.node.callspec.id}", max_age="10s")
    put = []
    for _ in range(5):
        put.append(channel.put(b"x").time)
        host.tick(SECOND)
    host.tick(0, wall_step=step)
    assert [item.time for item in channel.get(st.OLDEST, st.NOW)] == put
    host.tick(SECOND)  # 0.5 to 1.5 s, because the host's clock approaches the wall clock slowly
    assert [item.time for item in channel.get(*st.last("10s"), match="start")] == put


@STEPS
def test_a_stepped_wall_clock_does_not_freeze_a_channel(
    host: LoopbackHost, rt: st.Connection, step: int, request: pytest.FixtureRequest
) -> None:
    channel = rt.channel(f"flow/{request.node.callspec.id}", max_age="2s")
    times = [channel.put(b"x").time]
    host.tick(SECOND, wall_step=step)
    for _ in range(8):
        times.append(channel.put(b"x").time)
        host.tick(SECOND)
    gaps = {later - earlier for earlier, later in pairwise(times)}
    assert SECOND // 2 <= min(gaps) <= max(gaps) <= SECOND * 3 // 2
    assert 0 < channel.stats().held <= 6
    assert channel.stats().collected["age"] > 0


@STEPS
def test_a_put_that_waits_until_the_oldest_item_is_too_old_is_accepted_after_a_step(
    host: LoopbackHost, rt: st.Connection, step: int, request: pytest.FixtureRequest
) -> None:
    channel = rt.channel(f"full/{request.node.callspec.id}", max_items=1, max_age="2s", on_full="block")
    channel.put(b"first")
    host.tick(1)
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(channel.put, b"second")
        while channel.stats().waiting_puts < 1:
            pass
        host.tick(0, wall_step=step)
        assert not waiting.done()
        host.tick(SECOND)
        host.tick(4 * SECOND)
        assert waiting.result(20).payload == b"second"
