"""The metrics of channels: true sums, a bounded number of names, and no long step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers
from stampede_rt_channel_host.channels.totals import ChannelTotals
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel.pieces import run_to_end
from stampede_rt_channel_host.metrics import catalog
from stampede_rt_channel_host.metrics.catalog import NAMES_MAX
from stampede_rt_channel_host.metrics.channel_metrics import CHANNELS_PER_PIECE, ChannelMetrics
from stampede_rt_runtime.metrics.families import Family
from tests.support.clock import ManualClock

S = 10**9


class Host:
    """The part of a ChannelStore that the metrics need."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.now = self.clock.time_unix_nano
        self.memory = MemoryBudget(2**30)
        self.readers = Readers()
        self.departed = ChannelTotals()
        self.channels: dict[str, HostedChannel] = {}
        self.looked_at = 0

    def named_after(self, name: str, count: int) -> list[HostedChannel]:
        found = [self.channels[one] for one in sorted(self.channels) if one > name][:count]
        self.looked_at = max(self.looked_at, len(found))
        return found

    def open(self, name: str, policy: Policy | None = None) -> HostedChannel:
        spec = policy_to_spec(policy or Policy())
        record = channel_pb2.ChannelRecord(name=name, epoch=1, incarnation=5, spec=spec)
        hosted = self.channels[name] = HostedChannel(recorded_channel(record), self.memory, self.now)
        return hosted

    def put(self, hosted: HostedChannel, *payloads: bytes, ago_nanos: int = 0) -> None:
        encoded = encode_run(payloads, times=[self.now() - ago_nanos] * len(payloads))
        run = IncomingRun(encoded, producer_id=0, first_number=1, wait_nanos=None)
        assert hosted.puts.put(run, self.now()) is not None

    def drop(self, name: str) -> None:
        hosted = self.channels.pop(name)
        self.departed.add_counts(hosted, hosted.channel.latest_counters())


def metrics_of(host: Host, shows: Callable[[str], object] = lambda name: True) -> ChannelMetrics:
    store: Any = host
    return ChannelMetrics(store, shows)


def sample_values(families: list[Family]) -> dict[tuple[str, ...], float]:
    return {(one.metric.name, *labels): value for one in families for labels, value in one.samples}


def test_the_sums_count_accepted_rejected_and_collected_items() -> None:
    host = Host()
    left = host.open("left", Policy(max_items=2, on_full="drop_oldest"))
    for payload in (b"aa", b"bb", b"cc"):
        host.clock.advance(1)
        host.put(left, payload)
    host.put(left, b"late", ago_nanos=10 * S)
    left.count_delivered(2, 4)
    found = sample_values(run_to_end(metrics_of(host).families()))
    assert found["stampede_items_accepted_total",] == found["stampede_channel_items_accepted_total", "left"] == 3
    assert found["stampede_items_accepted_bytes_total",] == 6
    assert found["stampede_items_collected_total", "count"] == 1
    assert found["stampede_items_rejected_total", "too_old"] == 1
    assert found["stampede_channel_items_rejected_total", "left", "too_old"] == 1
    assert found["stampede_items_delivered_total",] == 2
    assert found["stampede_items_held",] == found["stampede_channel_items_held", "left"] == 2
    assert found["stampede_items_rejected_total", "in_future"] == 0  # a rate needs the 0 before the first rejected item


def test_an_item_after_one_with_a_later_time_is_late() -> None:
    host = Host()
    left = host.open("left")
    for ago_nanos in (0, 5, 0, 7):
        host.put(left, b"x", ago_nanos=ago_nanos)
    assert sample_values(run_to_end(metrics_of(host).families()))["stampede_items_late_total",] == 2


def test_the_newest_item_has_an_age() -> None:
    host = Host()
    left, _ = host.open("left"), host.open("empty")
    host.put(left, b"x")
    host.clock.advance(3 * S)
    found = sample_values(run_to_end(metrics_of(host).families()))
    assert found["stampede_channel_newest_item_age_seconds", "left"] == 3
    assert ("stampede_channel_newest_item_age_seconds", "empty") not in found


def test_a_counter_does_not_fall_when_its_channel_leaves() -> None:
    host = Host()
    host.put(host.open("left"), b"x")
    metrics = metrics_of(host)
    assert sample_values(run_to_end(metrics.families()))["stampede_items_accepted_total",] == 1
    host.drop("left")
    host.put(host.open("right"), b"y")
    found = sample_values(run_to_end(metrics.families()))
    assert found["stampede_items_accepted_total",] == 2
    assert found["stampede_items_held",] == 1


def test_no_counter_falls_when_a_channel_leaves_during_a_scrape() -> None:
    host = Host()
    for number in range(2 * CHANNELS_PER_PIECE):
        host.put(host.open(f"{number:04}"), b"x")
    metrics = metrics_of(host)
    run_to_end(metrics.families())
    looking = metrics.families()
    next(looking)
    host.drop(f"{2 * CHANNELS_PER_PIECE - 1:04}")  # the host has not looked at this channel yet
    found = sample_values(run_to_end(looking))
    assert found["stampede_items_accepted_total",] == 2 * CHANNELS_PER_PIECE


def test_many_channels_are_looked_at_in_pieces_and_only_the_busiest_have_names() -> None:
    host = Host()
    for number in range(5 * NAMES_MAX):
        hosted = host.open(f"{number:04}")
        hosted.count_delivered(1, number)
    work, pieces = metrics_of(host).families(), 0
    while True:
        try:
            next(work)
        except StopIteration as end:
            families = end.value
            break
        pieces += 1
    assert pieces >= 5 * NAMES_MAX // CHANNELS_PER_PIECE
    assert host.looked_at == CHANNELS_PER_PIECE
    assert all(len(one.samples) <= 6 * NAMES_MAX for one in families)
    names = {
        name for metric, *rest in sample_values(families) if metric == "stampede_channel_items_held" for name in rest
    }
    assert names == {f"{number:04}" for number in range(4 * NAMES_MAX, 5 * NAMES_MAX)}


def test_only_chosen_channels_have_names_but_all_count() -> None:
    host = Host()
    host.put(host.open("cam"), b"x")
    host.put(host.open("secret"), b"y")
    found = sample_values(run_to_end(metrics_of(host, lambda name: name == "cam").families()))
    assert found["stampede_items_accepted_total",] == 2
    assert not [key for key in found if "secret" in key]


def test_subscriptions_that_miss_items_are_named_the_worst_first() -> None:
    host = Host()
    reading = host.readers.reading
    with reading("left") as slow, reading("left"), reading("left") as slowest, reading("left") as slower:
        slow.count(5, 2)
        slowest.count(0, 9)
        slower.count(8, 0)
        found = sample_values(run_to_end(metrics_of(host).families()))
        assert [(key, value) for key, value in found.items() if key[0] == catalog.SUBSCRIPTION_DROPPED.name] == [
            ((catalog.SUBSCRIPTION_DROPPED.name, "left", "@anyone#3", "skipped"), 9),
            ((catalog.SUBSCRIPTION_DROPPED.name, "left", "@anyone#4", "collected"), 8),
            ((catalog.SUBSCRIPTION_DROPPED.name, "left", "@anyone#1", "collected"), 5),
            ((catalog.SUBSCRIPTION_DROPPED.name, "left", "@anyone#1", "skipped"), 2),
        ]
    found = sample_values(run_to_end(metrics_of(host).families()))
    assert found["stampede_items_dropped_total", "collected"] == 13  # also after the subscriptions have ended
    assert not [key for key in found if key[0] == catalog.SUBSCRIPTION_DROPPED.name]
