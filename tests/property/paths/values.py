"""The values of these tests: runs, waiting puts, subscriptions, and policies as callers state them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol

import stampede_rt as st
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import Offer
from tests.oracle import Ack, Item, OracleNewest, OracleSubscription, RefusedItem


class StartedCall(Protocol):
    """A call under way."""

    def is_done(self) -> bool:
        """Whether the call has its outcome."""

    def outcome(self) -> Any:
        """Wait for the result or the StampedeError. Fails after 20 s."""


class FollowedItems:
    """A subscription that a background task reads: its items so far, and the error with which it ended."""

    def __init__(self) -> None:
        self.items: list[st.Item] = []
        self.subscription: Any = None
        self.error: st.StampedeError | None = None
        self.ended = False
        self.work: Any = None  # the background task; without this reference Python may drop it


@dataclass(frozen=True)
class Run:
    """One run of a producer. `waits`: the run waits for room without limit; otherwise it does not wait."""

    offer: Offer
    payloads: Sequence[bytes]
    producer_id: int = 0
    first_number: int = 0
    waits: bool = False

    @property
    def numbers(self) -> range:
        return range(self.first_number, self.first_number + len(self.payloads))


@dataclass
class OracleRun:
    """A run in the oracle, and the verdicts on its first items. `rest` is the offer with the other items."""

    run: Run
    rest: Offer
    verdicts: list[Item | RefusedItem] = field(default_factory=list)
    started: StartedCall | None = None

    @property
    def is_partly_accepted(self) -> bool:
        return any(isinstance(one, Item) for one in self.verdicts)

    def refuse_rest(self, reason: str) -> int:
        """Refuse the items without a verdict for `reason`. Returns their number."""
        left = len(self.payloads_left)
        self.verdicts += [RefusedItem(reason)] * left
        return left

    @property
    def payloads_left(self) -> Sequence[bytes]:
        return self.run.payloads[len(self.verdicts) :]

    def resume(self, verdicts: Sequence[Item | RefusedItem], clock: int) -> None:
        """Take over the verdicts of an earlier put of the same run."""
        if len(verdicts) > len(self.verdicts):
            if len(verdicts) < len(self.run.payloads):
                self.rest = self.rest.rest(len(verdicts) - len(self.verdicts), clock)
            self.verdicts = list(verdicts)

    def ack(self, clock: int) -> Ack:
        """The ack of the run, once every item has its verdict."""
        stamped = self.run.offer.times is None
        accepted = [(at, one) for at, one in enumerate(self.verdicts) if isinstance(one, Item)]
        return Ack(
            accepted={at: (one.seq, one.time if stamped else None) for at, one in accepted},
            refused={at: one.reason for at, one in enumerate(self.verdicts) if isinstance(one, RefusedItem)},
            judged_at=clock,
        )


@dataclass
class Follower:
    """A subscription of the tested path, and the oracle's subscription that predicts its items."""

    followed: FollowedItems
    newest: bool
    predictor: OracleSubscription | OracleNewest
    expected: list[tuple[Item, int | None]] = field(default_factory=list)
    dropped: int = 0


def policy_arguments(policy: Policy) -> dict[str, Any]:
    """A policy as the client's arguments."""
    given = {one.name: getattr(policy, one.name) for one in fields(policy)}
    return {
        name.removesuffix("_nanos"): f"{value}ns" if name.endswith("_nanos") else value
        for name, value in given.items()
        if value is not None
    }


def merge(policy: Policy, change: Policy) -> Policy:
    """The policy of a channel after a change. Settings that the change does not state stay as they are."""
    given = {one.name: getattr(change, one.name) for one in fields(change)}
    return replace(policy, **{name: value for name, value in given.items() if value is not None})
