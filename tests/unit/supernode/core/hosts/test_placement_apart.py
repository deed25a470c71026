"""Private hosts get only what a caller places there by name. Replicas go to other machines first."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.core.cluster.commands import RaiseFeatureLevel
from stampede_rt_supernode.core.cluster.feature_levels import LOADS_LEVEL
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.replicas.commands import ReplicaAdded
from tests.support.supernode.operations import Log, add_replica, id_of, open_channel, register


def log_of(**machines: str) -> Log:
    """Hosts 1, 2, ... on these machines. A host is private if its keyword ends with "private"."""
    log = Log()
    log.apply(RaiseFeatureLevel(feature_level=LOADS_LEVEL))
    for number, (name, machine) in enumerate(machines.items(), 1):
        log.apply(replace(register(number), machine=machine, is_private=name.endswith("private")))
    return log


def opened(log: Log, name: str, host: str = "") -> ChannelOpened:
    result = log.apply(open_channel(name, host=host))
    assert isinstance(result, ChannelOpened), result
    return result


def replica_at(log: Log, channel_id: bytes) -> bytes:
    result = log.apply(add_replica(channel_id, warm=True))
    assert isinstance(result, ReplicaAdded), result
    return result.host.host_id


def test_a_private_host_gets_only_channels_whose_callers_name_it() -> None:
    log = log_of(a_private="m1", b="m1")
    assert {opened(log, f"cam/{at}").host.name for at in range(4)} == {"host-2"}
    assert opened(log, "mine", host="host-1").host.name == "host-1"


def test_a_private_host_gets_a_replica_only_if_the_caller_names_the_host() -> None:
    log = log_of(a="m1", b_private="m2")
    channel_id = opened(log, "cam", host="host-1").channel.channel_id
    refused = log.apply(add_replica(channel_id, warm=True))
    assert isinstance(refused, RefusedOperation)
    assert (refused.reason, "or is private" in refused.message) == ("NO_HOST", True)
    named = log.apply(add_replica(channel_id, 2, warm=True))
    assert isinstance(named, ReplicaAdded)


@pytest.mark.parametrize("busy", [0, 5])
def test_replicas_go_to_other_machines_first(busy: int) -> None:
    log = log_of(a="m1", b="m1", c="m2", d="m2")
    for at in range(busy):
        opened(log, f"other/{at}", host="host-3")
        opened(log, f"another/{at}", host="host-4")
    channel_id = opened(log, "cam", host="host-1").channel.channel_id
    first, second = replica_at(log, channel_id), replica_at(log, channel_id)
    assert first in (id_of(3), id_of(4))
    assert second == id_of(2)  # each machine has a copy, so the load and the number of copies decide


def test_hosts_with_unknown_machines_are_chosen_only_by_their_numbers_of_channels() -> None:
    log = log_of(a="", b="", c="")
    channel_id = opened(log, "cam", host="host-1").channel.channel_id
    assert replica_at(log, channel_id) == id_of(2)
