"""The destinations of the channels of a drained host."""

from __future__ import annotations

from stampede_rt_channel_host.core.placing import OtherHost, connected_sets, spread


def host(name: str, busy_permille: int = 0, channels: int = 0) -> OtherHost:
    return OtherHost(name.encode(), name, f"{name}:1", busy_permille, channels)


def test_channels_that_share_groups_directly_or_indirectly_are_placed_together() -> None:
    groups = {b"a": [b"1"], b"b": [b"2"], b"c": [], b"d": [b"1", b"2"], b"e": [b"3"]}
    assert sorted(sorted(one) for one in connected_sets(groups)) == [[b"a", b"b", b"d"], [b"c"], [b"e"]]


def test_the_least_busy_host_gets_channels_and_equally_busy_hosts_share_them() -> None:
    hosts = [host("h1", 900), host("h2", 110, 5), host("h3", 190, 4)]
    places = spread([[b"a"], [b"b"], [b"c"]], hosts)
    assert sorted(one.name for one in places.values()) == ["h2", "h3", "h3"]


def test_channels_that_belong_together_go_to_one_host() -> None:
    places = spread([[b"a", b"b", b"c"], [b"d"]], [host("h1"), host("h2")])
    assert places[b"a"] == places[b"b"] == places[b"c"] != places[b"d"]
