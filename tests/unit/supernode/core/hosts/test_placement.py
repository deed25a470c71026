"""The choice of a host by the loads of hosts."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.channels.commands import ChannelOpened
from stampede_rt_supernode.core.cluster.commands import RaiseFeatureLevel
from stampede_rt_supernode.core.cluster.feature_levels import LOADS_LEVEL
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.hosts.commands import HostLoadsNoted, NoteHostLoads, ReportedLoad
from stampede_rt_supernode.core.hosts.placement import (
    CHANNELS_PER_HOST_MAX,
    SHARE_FACTOR,
    SHARE_FREE,
    STEP_PERMILLE,
    THING_PERMILLE,
)
from stampede_rt_supernode.core.records import HostLoad
from tests.support.supernode.operations import Log, deregister, id_of, open_channel, open_group, open_queue, register


def log_with_hosts(count: int, level: int = LOADS_LEVEL) -> Log:
    log = Log()
    log.apply(RaiseFeatureLevel(feature_level=level))
    for number in range(1, count + 1):
        log.apply(register(number))
    return log


def note(log: Log, loads: dict[int, HostLoad], tenure: int = 1) -> int:
    hosts = log.directory.tables.hosts
    reported = (
        ReportedLoad(host_id=id_of(one), registered_index=hosts[id_of(one)].registered_index, load=load)
        for one, load in loads.items()
    )
    noted = log.apply(NoteHostLoads(tenure=tenure, loads=tuple(reported)))
    assert isinstance(noted, HostLoadsNoted)
    return noted.noted


def opened_at(log: Log, name: str) -> str:
    opened = log.apply(open_channel(name))
    assert isinstance(opened, ChannelOpened), opened
    return opened.host.name


def test_a_new_channel_is_placed_on_the_least_loaded_host_even_if_this_host_has_more_channels() -> None:
    log = log_with_hosts(2)
    for number in range(4):
        log.apply(open_channel(f"quiet/{number}", host="host-2"))
    note(log, {1: HostLoad(busy_permille=800), 2: HostLoad(busy_permille=100, owned=4)})
    assert opened_at(log, "new") == "host-2"


def test_a_new_channel_avoids_a_host_whose_memory_is_full() -> None:
    log = log_with_hosts(2)
    note(log, {1: HostLoad(held_bytes=990, bytes_max=1000), 2: HostLoad(busy_permille=2000)})
    assert opened_at(log, "new") == "host-2"
    note(log, {2: HostLoad(held_bytes=999, bytes_max=1000)})
    assert opened_at(log, "another") in ("host-1", "host-2"), "if all hosts are full, one of them gets the channel"


def test_opens_between_two_reports_spread_over_the_hosts() -> None:
    log = log_with_hosts(3)
    note(log, {1: HostLoad(busy_permille=0), 2: HostLoad(busy_permille=200), 3: HostLoad(busy_permille=200)})
    found = Counter(opened_at(log, f"cam/{number}") for number in range(40))
    assert found["host-2"] >= 8
    assert found["host-3"] >= 8
    assert found["host-1"] > found["host-2"], "the idle host gets most channels"


@given(hosts=st.integers(1, 6), opens=st.integers(0, 60), busy=st.integers(0, 1000))
def test_hosts_of_equal_load_get_equal_numbers_of_channels(hosts: int, opens: int, busy: int) -> None:
    log = log_with_hosts(hosts)
    note(log, {number: HostLoad(busy_permille=busy) for number in range(1, hosts + 1)})
    found = Counter(opened_at(log, f"c/{number}") for number in range(opens))
    counts = [found[f"host-{number}"] for number in range(1, hosts + 1)]
    assert max(counts) - min(counts) <= max(1, STEP_PERMILLE // THING_PERMILLE)


@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("load"), st.integers(1, 4), st.integers(0, 3000)),
            st.tuples(st.just("open"), st.integers(0, 30), st.just(0)),
        ),
        max_size=40,
    )
)
def test_a_replica_that_began_from_a_snapshot_makes_the_same_choices(steps: list[tuple[str, int, int]]) -> None:
    log, other = log_with_hosts(4), log_with_hosts(4)
    for kind, number, busy in steps:
        other.directory = decode_snapshot(encode_snapshot(other.directory))
        opening = open_channel(f"c/{number}")
        for one in (log, other):
            if kind == "load":
                note(one, {number: HostLoad(busy_permille=busy, held_bytes=busy, bytes_max=4000, owned=number)})
            else:
                one.apply(opening)
    assert other.directory.tables.channels == log.directory.tables.channels
    assert other.directory.tables.hosts == log.directory.tables.hosts


def test_a_queue_is_placed_on_the_least_loaded_host() -> None:
    log = log_with_hosts(2)
    note(log, {1: HostLoad(busy_permille=500)})
    log.apply(open_queue("jobs"))
    assert [one.host_id for one in log.directory.tables.queues.by_id.values()] == [id_of(2)]


def test_members_of_a_group_are_placed_together_when_their_host_is_lost() -> None:
    log = log_with_hosts(4)
    members = []
    for name in ("left", "right", "depth"):
        opened = log.apply(open_channel(name, host="host-1"))
        assert isinstance(opened, ChannelOpened)
        members.append(opened.channel.channel_id)
    log.apply(open_group("stereo", tuple(members)))
    log.apply(deregister(1))
    assert len({opened_at(log, name) for name in ("left", "right", "depth")}) == 1
    others = {opened_at(log, f"other/{number}") for number in range(2)}
    assert others == {"host-2", "host-3", "host-4"} - {opened_at(log, "left")}


def test_a_member_of_a_group_is_placed_elsewhere_if_the_host_is_too_loaded() -> None:
    log = log_with_hosts(3)
    left = log.apply(open_channel("left", host="host-1"))
    right = log.apply(open_channel("right", host="host-2"))
    assert isinstance(left, ChannelOpened)
    assert isinstance(right, ChannelOpened)
    log.apply(open_group("stereo", (left.channel.channel_id, right.channel.channel_id)))
    note(log, {1: HostLoad(busy_permille=990)})
    log.apply(deregister(2))
    assert opened_at(log, "right") == "host-3"


@pytest.mark.parametrize("named", ["", "host-1"])
def test_a_host_gets_no_more_channels_than_it_can_own(named: str) -> None:
    log = log_with_hosts(1)
    tables = log.directory.tables
    tables.hosts[id_of(1)] = replace(tables.hosts[id_of(1)], channels=CHANNELS_PER_HOST_MAX)
    refused = log.apply(open_channel("one-more", host=named))
    assert isinstance(refused, RefusedOperation)
    assert "host-1 owns 100000 channels, and a host owns at most 100000" in refused.message
    log.apply(register(2))
    assert opened_at(log, "one-more") == "host-2"


def test_loads_of_another_leader_or_of_a_former_registration_have_no_effect() -> None:
    log = log_with_hosts(1)
    assert note(log, {1: HostLoad(busy_permille=9)}, tenure=2) == 0
    old = ReportedLoad(host_id=id_of(1), registered_index=1, load=HostLoad(busy_permille=9))
    assert log.apply(NoteHostLoads(tenure=1, loads=(old,))) == HostLoadsNoted(noted=0)
    assert log.directory.tables.hosts[id_of(1)].load == HostLoad()


def test_below_the_feature_level_hosts_have_no_load_and_the_number_of_channels_decides() -> None:
    log = log_with_hosts(2, level=LOADS_LEVEL - 1)
    assert {host.load for host in log.directory.tables.hosts.values()} == {None}
    assert [opened_at(log, f"c/{number}") for number in range(3)] == ["host-1", "host-2", "host-1"]


def test_watchers_see_no_change_when_loads_are_noted() -> None:
    log = log_with_hosts(1)
    before = log.directory.tables.changes.end_position
    assert note(log, {1: HostLoad(busy_permille=900)}) == 1
    assert log.directory.tables.changes.end_position == before


def opened_beside(log: Log, name: str, beside: str) -> str:
    opened = log.apply(replace(open_channel(name), beside=beside))
    assert isinstance(opened, ChannelOpened), opened
    return opened.host.name


def test_a_channel_opens_beside_the_named_channel_even_if_other_hosts_are_less_busy() -> None:
    log = log_with_hosts(3)
    log.apply(open_channel("left", host="host-3"))
    note(log, {3: HostLoad(busy_permille=940)})
    assert {opened_beside(log, f"member/{number}", "left") for number in range(60)} == {"host-3"}
    assert opened_at(log, "stranger") != "host-3"


@pytest.mark.parametrize("load", [HostLoad(busy_permille=960), HostLoad(held_bytes=99, bytes_max=100)])
def test_a_channel_opens_elsewhere_if_the_host_of_the_named_channel_has_no_room(load: HostLoad) -> None:
    log = log_with_hosts(2)
    log.apply(open_channel("left", host="host-1"))
    note(log, {1: load})
    assert opened_beside(log, "right", "left") == "host-2"


def test_a_channel_opens_elsewhere_if_the_host_of_the_named_channel_is_lost() -> None:
    log = log_with_hosts(2)
    log.apply(open_channel("left", host="host-1"))
    log.apply(deregister(1))
    assert opened_beside(log, "right", "left") == "host-2"


def test_an_existing_channel_is_not_moved_if_beside_names_another_host() -> None:
    log = log_with_hosts(2)
    log.apply(open_channel("left", host="host-1"))
    log.apply(open_channel("right", host="host-2"))
    assert opened_beside(log, "right", "left") == "host-2"
    assert opened_beside(log, "right", "nobody") == "host-2"


def test_a_channel_of_a_lost_host_opens_beside_another_channel_if_that_one_has_a_host() -> None:
    log = log_with_hosts(3)
    log.apply(open_channel("left", host="host-3"))
    log.apply(open_channel("right", host="host-1"))
    log.apply(open_channel("depth", host="host-1"))
    log.apply(deregister(1))
    assert opened_beside(log, "right", "left") == "host-3"
    assert opened_beside(log, "depth", "nobody") == "host-2"


@pytest.mark.parametrize(
    ("host", "beside", "reason", "text"),
    [
        ("", "nobody", "CHANNEL_NOT_FOUND", "there is no such channel; open that one first"),
        ("host-1", "left", "INVALID_ARGUMENT", "state one of them"),
        ("", "a name", "INVALID_NAME", "a name"),
    ],
)
def test_a_channel_that_cannot_be_beside_another_is_refused(host: str, beside: str, reason: str, text: str) -> None:
    log = log_with_hosts(1)
    log.apply(open_channel("left"))
    refused = log.apply(replace(open_channel("right", host=host), beside=beside))
    assert isinstance(refused, RefusedOperation)
    assert refused.reason == reason
    assert text in refused.message


def test_below_the_feature_level_no_channel_opens_beside_another() -> None:
    log = log_with_hosts(2, level=LOADS_LEVEL - 1)
    log.apply(open_channel("left", host="host-1"))
    assert opened_beside(log, "right", "left") == "host-2"


@given(hosts=st.integers(2, 5), busy=st.integers(100, 900))
def test_a_host_that_always_reports_no_load_does_not_get_all_channels(hosts: int, busy: int) -> None:
    log = log_with_hosts(hosts)
    opens = 300
    found: Counter[str] = Counter()
    for number in range(opens):
        if number % 5 == 0:  # the host reports that its channels do nothing, and the other hosts have much to do
            owned = {one: found[f"host-{one}"] for one in range(1, hosts + 1)}
            note(log, {one: HostLoad(busy_permille=0 if one == 1 else busy, owned=owned[one]) for one in owned})
        found[opened_at(log, f"c/{number}")] += 1
    others = (opens - found["host-1"]) / (hosts - 1)
    assert found["host-1"] <= SHARE_FREE + SHARE_FACTOR * others + 1
    assert others > 0


def test_a_host_with_far_more_channels_gets_another_only_if_the_other_hosts_have_no_room() -> None:
    log = log_with_hosts(2)
    for number in range(SHARE_FREE + 1):
        log.apply(open_channel(f"c/{number}", host="host-1"))
    note(log, {1: HostLoad(owned=SHARE_FREE + 1), 2: HostLoad(busy_permille=500)})
    assert opened_at(log, "one") == "host-2"
    note(log, {2: HostLoad(busy_permille=960, owned=1)})
    assert opened_at(log, "another") == "host-1"


def test_a_host_without_reports_counts_with_its_own_channels() -> None:
    log = log_with_hosts(2)
    tables = log.directory.tables
    tables.hosts[id_of(1)] = replace(tables.hosts[id_of(1)], load=None)  # as of a host whose release makes no reports
    note(log, {2: HostLoad(busy_permille=100)})
    found = Counter(opened_at(log, f"c/{number}") for number in range(40))
    assert min(found.values()) >= 15, "neither host gets all channels"
