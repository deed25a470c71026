"""Hostile and good callers at the same time, in processes of their own. The checks must hold on busy machines, too.

`python -m tests.benchmarks.attacks` measures the same attacks, and more of them. The suite runs a few, and `make
robustness` runs all.
"""

from __future__ import annotations

import pytest
from _pytest.mark.structures import ParameterSet

from stampede_rt_channel_host.channels.limits.request_room import CALLER_BYTES_MAX
from stampede_rt_runtime.limits import Limits
from tests.benchmarks.attacks.trial import AttackResult, Setup, trial

SECONDS = 2.0
BUDGET_MIB = 64  # the memory budget of the host
MARGIN_MIB = 100


def rare(*names: str) -> list[ParameterSet]:
    """Attacks that only long runs include."""
    return [pytest.param(name, marks=pytest.mark.slow) for name in names]


async def attacked(name: str) -> AttackResult:
    found = await trial(name, SECONDS, Setup(compares=False))
    assert found.beside.calls > 0
    assert found.beside.failures == []
    assert found.leases_lost == 0
    return found


@pytest.mark.parametrize("name", ["resets", *rare("health-headers", "unfinished-health", "idle-connections")])
async def test_a_caller_without_a_credential_harms_no_calls_and_leases_of_others_and_takes_no_memory(name: str) -> None:
    found = await attacked(name)
    assert found.after_mib < found.before_mib + MARGIN_MIB


@pytest.mark.parametrize(
    "name",
    [
        *rare("tcp-silent", "tcp-malformed", "tcp-unfinished", "tcp-silent-gets", "tcp-half-closed"),
        *rare("tls-unfinished", "tls-hellos", "tls-malformed"),
    ],
)
async def test_a_hostile_caller_of_a_data_port_harms_no_calls_and_leases_of_others_and_takes_little_memory(
    name: str,
) -> None:
    """The good clients use the port, too."""
    found = await attacked(name)
    assert found.after_mib < found.before_mib + BUDGET_MIB + MARGIN_MIB


async def test_bytes_that_are_no_request_cause_no_line_in_the_logs() -> None:
    assert (await attacked("malformed")).log_bytes < 10_000


@pytest.mark.parametrize("name", ["unfinished-puts", *rare("unfinished-messages")])
async def test_unfinished_requests_take_at_most_the_room_of_a_caller_and_a_small_window_for_each_stream(
    name: str,
) -> None:
    found = await attacked(name)
    windows_bytes = 1000 * Limits().request_bytes_max if name == "unfinished-messages" else CALLER_BYTES_MAX
    assert found.most_mib < found.before_mib + windows_bytes / 2**20 + MARGIN_MIB


@pytest.mark.parametrize(
    "name",
    [
        *rare("busy-puts", "large-gets", "many-subscriptions", "blocked-gets", "many-streams", "held-bytes"),
        *rare("many-cuts", "many-matches", "busy-takes", "single-calls", "new-channels"),
    ],
)
async def test_a_client_that_uses_its_whole_quota_harms_no_calls_and_leases_of_others(name: str) -> None:
    await attacked(name)


@pytest.mark.parametrize(
    "name",
    [
        "waiting-puts",
        *rare("repeated-fields", "refused-runs", "unknown-fields", "waiting-enqueues"),
        *rare("silent-subscriptions", "silent-takers"),
    ],
)
async def test_the_memory_of_hostile_clients_returns_to_the_system_without_a_failed_call(name: str) -> None:
    found = await attacked(name)
    assert found.after_mib < found.before_mib + BUDGET_MIB + MARGIN_MIB
