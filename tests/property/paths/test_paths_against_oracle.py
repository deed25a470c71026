"""The core and a client over each transport, with certificates and without, give the oracle's answers after any steps.

`STAMPEDE_PROPERTY_EXAMPLES=20000 pytest tests/property/paths/test_paths_against_oracle.py` tries more steps. `python -m
tests.property core 0 100000` does the same several times as fast.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence

import pytest
from hypothesis import HealthCheck, given, note, seed, settings
from hypothesis import strategies as st

from stampede_rt.errors import ChannelNotFound
from stampede_rt.transports import futexes
from stampede_rt_local.certificates import ClusterCertificates
from tests.property.paths.core_surface import core_surface
from tests.property.paths.path_and_oracle import SteeredHost
from tests.property.paths.steered_rings import steered_rings
from tests.property.paths.steps import STEPS, STEPS_NEAR_THE_NEWEST, Step, play
from tests.property.paths.surfaces import TRANSPORTS, Surface, awaited_surface, blocking_surface
from tests.support.channel_host.loopback_host import LoopbackHost, loopback_host

# The clients draw the delays of their retries in their own threads, whatever hypothesis is doing.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "50"))
RING_ANSWERS = ("get", "newest", "subscription")
ROUNDS_MAX = 10  # about half of the rounds lack one of these answers
SURFACES = {"awaited": awaited_surface, "blocking": blocking_surface}


@pytest.fixture(scope="module", params=["plain", "with TLS"])
def host(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LoopbackHost]:
    secured = request.param == "with TLS"
    with loopback_host(ClusterCertificates(tmp_path_factory.mktemp("tls") / "certs") if secured else None) as running:
        yield running


@pytest.fixture(scope="module")
def ring_answers(host: LoopbackHost) -> Iterator[Counter[str]]:
    with steered_rings(host) as answers:
        yield answers


@pytest.fixture(scope="module", params=SURFACES)
def surface(request: pytest.FixtureRequest, host: LoopbackHost, ring_answers: Counter[str]) -> Iterator[Surface]:
    with SURFACES[request.param](host) as connected:
        yield connected


def play_scenarios(
    surface: Surface, host: SteeredHost, examples: int, first: int = 0, steps: Sequence[Step] = STEPS
) -> None:
    @seed(first)
    @settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), database=None)
    @given(st.lists(st.integers(0, 2**96), min_size=20, max_size=40))
    def every_scenario(numbers: list[int]) -> None:
        play(surface, host, numbers, note, steps)

    every_scenario()


def test_a_retry_does_not_create_a_deleted_channel_again(surface: Surface) -> None:
    """In an earlier version of these tests, a get that had to look for its channel created a new one, and waited there
    for ever.
    """
    for connection in surface.connections:
        with pytest.raises(ChannelNotFound):
            surface.do(lambda connection=connection: connection.channel("deleted", create=False))


def test_each_client_of_the_scenarios_uses_its_own_transport(surface: Surface) -> None:
    used: list[str | None] = []
    for connection in surface.connections:
        channel = surface.do(lambda connection=connection: connection.channel("transports", max_items=1))
        surface.do(lambda channel=channel: channel.put(b"x"))
        used.append(surface.do(channel.stats).transport)
    assert used == list(TRANSPORTS)


@pytest.mark.timeout(0 if EXAMPLES > 500 else 240)
def test_a_client_agrees_with_the_oracle_in_every_scenario(
    surface: Surface, host: LoopbackHost, ring_answers: Counter[str]
) -> None:
    ring_answers.clear()
    if host.tls is not None:
        play_scenarios(surface, host, EXAMPLES)
        return
    play_scenarios(surface, host, EXAMPLES)
    for turn in range(ROUNDS_MAX):
        play_scenarios(surface, host, EXAMPLES, first=turn, steps=STEPS_NEAR_THE_NEWEST)
        if not futexes.is_supported() or all(ring_answers[kind] for kind in RING_ANSWERS):
            return
    raise AssertionError(f"no scenario read everything from shared memory: {ring_answers}")


@pytest.mark.timeout(0 if EXAMPLES > 500 else 240)
@pytest.mark.parametrize("items_per_block", [2, 1024])
def test_an_embedded_host_agrees_with_the_oracle_in_every_scenario(items_per_block: int) -> None:
    with core_surface(items_per_block) as (surface, host):
        play_scenarios(surface, host, 2 * EXAMPLES)
