"""The rates of channels, computed from two readings of their counters. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from statistics import pstdev

from stampede_rt.values.statistics import ChannelStats

CounterReading = Mapping[str, tuple[str, ChannelStats]]
"""By the name of each channel: its host, and its counters."""
SORTS = ("bytes", "items", "age", "lag", "held", "refused", "dropped", "name")


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelRates:
    """One channel between two readings of its counters. Rates are per second.

    `age_nanos`: the age of the newest item; None without an item. `lag_items`: the items that the slowest consumer or
    copy has not got yet. `refused`: items of refused puts. `dropped`: items that slow readers did not get.
    """

    channel: str
    host: str
    items: float
    bytes_in: float
    bytes_out: float
    refused: float
    dropped: float
    lag_items: int
    age_nanos: int | None
    held: int
    subscriptions: int


def rates_of(before: CounterReading, after: CounterReading) -> list[ChannelRates]:
    """The rates of the channels in `after`. They are 0 for a channel that `before` lacks, or that has begun anew."""
    return [_rates(name, host, before.get(name), now) for name, (host, now) in after.items()]


def _rates(name: str, host: str, former: tuple[str, ChannelStats] | None, now: ChannelStats) -> ChannelRates:
    then = now if former is None or former[1].incarnation != now.incarnation else former[1]
    seconds = max((now.host_time - then.host_time) / 1e9, 1e-9)
    refused = sum(now.rejected.values()) - sum(then.rejected.values())
    waiting = [one.waiting for one in now.consumers] + [one.waiting for one in now.copies]
    return ChannelRates(
        channel=name,
        host=host,
        items=max(0, now.accepted - then.accepted) / seconds,
        bytes_in=max(0, now.accepted_bytes - then.accepted_bytes) / seconds,
        bytes_out=max(0, now.delivered_bytes - then.delivered_bytes) / seconds,
        refused=max(0, refused) / seconds,
        dropped=max(0, now.dropped - then.dropped) / seconds,  # `dropped` falls when a slow reader leaves
        lag_items=max(waiting, default=0),
        age_nanos=None if now.newest is None else now.host_time - now.newest,
        held=now.held,
        subscriptions=now.subscriptions,
    )


def arranged(rows: Iterable[ChannelRates], sort: str, text: str = "") -> list[ChannelRates]:
    """The rows whose channel contains `text`, the greatest first by one of SORTS; by "name" from a to z."""
    chosen = sorted((row for row in rows if text in row.channel), key=lambda row: row.channel)
    if sort == "name":
        return chosen
    return sorted(chosen, key=lambda row: _value(row, sort), reverse=True)


def _value(row: ChannelRates, sort: str) -> float:
    values = {
        "bytes": row.bytes_in + row.bytes_out,
        "items": row.items,
        "age": -1.0 if row.age_nanos is None else float(row.age_nanos),
        "held": float(row.held),
        "lag": float(row.lag_items),
        "refused": row.refused,
        "dropped": row.dropped,
    }
    return values[sort]


def jitter_of(times: Iterable[int]) -> int | None:
    """Return the standard deviation of the times between items, in nanoseconds; None with fewer than three items."""
    ordered = sorted(times)
    gaps = [later - earlier for earlier, later in pairwise(ordered)]
    return round(pstdev(gaps)) if len(gaps) > 1 else None
