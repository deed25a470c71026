"""What a story over a path keeps in mind: puts in line, subscriptions, and set-ups as callers state them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from stampede_rt.model import Policy
from stampede_rt_channel_host.core.channel import Offer
from tests.oracle import Item, OracleNewest, OracleSubscription, Refused
from tests.property.surfaces import Followed, Started


@dataclass
class WaitingPut:
    """A put that stands in line; `settled` are the verdicts of its items up to now."""

    offer: Offer
    payloads: list[bytes]
    started: Started
    settled: list[Item | Refused] = field(default_factory=list)


@dataclass
class Follower:
    """A subscription, by the book and as it is."""

    followed: Followed
    newest: bool
    book: OracleSubscription | OracleNewest
    expected: list[tuple[Item, int | None]] = field(default_factory=list)
    dropped: int = 0


def stated(policy: Policy) -> dict[str, Any]:
    """A policy as the client's arguments."""
    durations = {"max_age": policy.max_age_nanos, "max_future": policy.max_future_nanos}
    counts = {"max_items": policy.max_items, "max_bytes": policy.max_bytes, "on_full": policy.on_full}
    written = {key: f"{nanos}ns" for key, nanos in durations.items() if nanos is not None}
    return written | {key: value for key, value in counts.items() if value is not None}


def merge(policy: Policy, change: Policy) -> Policy:
    """What a channel is set up as after a change that leaves things out."""
    names = ("max_age_nanos", "max_items", "max_bytes", "on_full", "max_future_nanos")
    changes = {name: getattr(change, name) for name in names if getattr(change, name) is not None}
    return replace(policy, **changes)
