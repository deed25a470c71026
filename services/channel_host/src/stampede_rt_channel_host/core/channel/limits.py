"""A policy, checked and with its defaults filled in (paper, section 3.4). Pure."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import OVERLAP_NANOS_MAX, Policy
from stampede_rt.values.timeline import MAX_INSTANT, format_duration
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES

DEFAULT_MAX_BYTES = 256 * 1024 * 1024
DEFAULT_MAX_FUTURE_NANOS = 1_000_000_000
ITEM_BYTES_MAX = 16 * 1024 * 1024
CONSUMERS_MAX = 1024
POLICIES_SHARED_MAX = 1024  # the most different policies whose limits are shared between channels

DROP_OLDEST = "drop_oldest"
BLOCK = "block"
REJECT = "reject"


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelLimits:
    """The limits of a channel. A field is None if the channel has no such limit."""

    max_age_nanos: int | None
    max_items: int | None
    max_bytes: int
    max_item_bytes: int
    max_future_nanos: int
    on_full: str
    consumers: int | None
    max_age_unconsumed_nanos: int | None
    overlap_nanos: int = 0

    @classmethod
    @lru_cache(maxsize=POLICIES_SHARED_MAX)  # channels with equal policies share one object
    def of(cls, policy: Policy) -> ChannelLimits:
        """The limits of a policy, with the defaults for values that it does not state.

        The default of max_bytes is 256 MiB. The default of max_age is 10 s if the policy states none of max_age,
        max_items, max_bytes and consumers; otherwise there is no limit of age. Raises InvalidArgument if a value, or a
        combination of values, is not possible.
        """
        _check(policy)
        return cls(
            max_age_nanos=policy.effective_max_age_nanos,
            max_items=policy.max_items,
            max_bytes=DEFAULT_MAX_BYTES if policy.max_bytes is None else policy.max_bytes,
            max_item_bytes=ITEM_BYTES_MAX if policy.max_item_bytes is None else policy.max_item_bytes,
            max_future_nanos=DEFAULT_MAX_FUTURE_NANOS if policy.max_future_nanos is None else policy.max_future_nanos,
            on_full=policy.on_full or DROP_OLDEST,
            consumers=policy.consumers,
            max_age_unconsumed_nanos=policy.max_age_unconsumed_nanos,
            overlap_nanos=policy.overlap_nanos or 0,
        )

    @property
    def drops_oldest(self) -> bool:
        """Whether a full channel drops the oldest items for new ones."""
        return self.on_full == DROP_OLDEST

    def is_a_fourth(self, waiting_bytes: int, waiting_items: int) -> bool:
        """Whether the items that wait for the archive are a fourth of max_bytes or max_items.

        max_items counts only if a full channel drops no items. Of the limits, only max_bytes collects items that are
        not archived yet. If many more items waited, max_bytes would collect them, or puts would have to wait.
        """
        most_items = None if self.drops_oldest else self.max_items
        return 4 * waiting_bytes >= self.max_bytes or (most_items is not None and 4 * waiting_items >= most_items)

    @property
    def consumer_places(self) -> int:
        """The number of consumer places. If it is 0, the channel counts no consumption, and keeps no data for it."""
        adapts = self.max_age_unconsumed_nanos is not None
        return self.consumers or (CONSUMERS_MAX if adapts else 0)

    def describe(self, cause: str) -> str:
        """The limit that has the effect `cause`, as a text for readers, such as `max_age (10 s)`."""
        if cause == "age" and self.max_age_nanos is not None:
            longest = self.max_age_unconsumed_nanos
            more = (
                "" if longest is None else f", {format_duration(longest)} for items that a consumer has yet to consume"
            )
            return f"max_age ({format_duration(self.max_age_nanos)}{more})"
        if cause == "consumption":
            return f"consumers ({self.consumers})" if self.consumers else "an earlier number of consumers"
        if cause == "count":
            return f"max_items ({self.max_items})"
        return f"max_bytes ({self.max_bytes})" if cause == "bytes" else f"an earlier max_{cause}"


def _check(policy: Policy) -> None:
    """Raises InvalidArgument if a value of the policy, or a combination of values, is not possible."""
    _check_range("max_age", policy.max_age_nanos, 1, MAX_INSTANT, "nanoseconds")
    _check_range("max_items", policy.max_items, 1, MAX_INSTANT, "items")
    _check_range("max_bytes", policy.max_bytes, ITEM_OVERHEAD_BYTES, MAX_INSTANT, "bytes (64 of them for each item)")
    _check_range("max_future", policy.max_future_nanos, 0, MAX_INSTANT, "nanoseconds")
    _check_range("overlap", policy.overlap_nanos, 1, OVERLAP_NANOS_MAX, "nanoseconds")
    _check_range("max_item_bytes", policy.max_item_bytes, 0, ITEM_BYTES_MAX, "bytes")
    _check_range("consumers", policy.consumers, 1, CONSUMERS_MAX, "consumers")
    if policy.on_full not in (None, DROP_OLDEST, BLOCK, REJECT):
        raise InvalidArgument(f'on_full is {policy.on_full!r}; write "drop_oldest", "block" or "reject"')
    ends = policy.max_age_nanos is not None or policy.consumers is not None
    if policy.on_full == BLOCK and not ends and (policy.max_items or policy.max_bytes):
        raise InvalidArgument(
            'on_full is "block" without max_age or consumers: a full channel would block for ever; state one of them, '
            'or use "reject"'
        )
    if policy.is_recorded and (policy.consumers or policy.max_age_unconsumed_nanos):
        raise InvalidArgument(
            "the policy has an archive and consumers; a recorded channel keeps its items, so no consumer uses them up: "
            "leave one of the two out"
        )
    _check_adaptive(policy)


def _check_adaptive(policy: Policy) -> None:
    max_age, longest_age = policy.max_age_nanos, policy.max_age_unconsumed_nanos
    if longest_age is not None and (max_age is None or not max_age <= longest_age <= MAX_INSTANT):
        stated = "is not stated" if max_age is None else f"is {format_duration(max_age)}"
        raise InvalidArgument(
            f"max_age_unconsumed is {format_duration(longest_age)} and max_age, which it prolongs for consumers that "
            f"lag, {stated}; state both, max_age_unconsumed not below max_age"
        )


def _check_range(name: str, value: int | None, least: int, most: int, unit: str) -> None:
    if value is not None and not least <= value <= most:
        raise InvalidArgument(f"{name} is {value}; it must be between {least} and {most} {unit}, or left out")


def check_policy_change(held: Policy, change: Policy) -> None:
    """Raises InvalidArgument if the channel could not have the policy `held` with the values that `change` states."""
    values = {field.name: getattr(change, field.name) for field in fields(change)}
    ChannelLimits.of(replace(held, **{name: value for name, value in values.items() if value is not None}))
