"""The limits of a channel, from its policy and the defaults."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelLimits


def test_a_policy_without_any_limit_keeps_ten_seconds_and_256_mebibytes() -> None:
    limits = ChannelLimits.of(Policy())
    assert limits.max_age_nanos == 10_000_000_000
    assert limits.max_bytes == 256 * 1024 * 1024
    assert limits.max_items is None
    assert limits.max_future_nanos == 1_000_000_000
    assert limits.drops_oldest


@pytest.mark.parametrize("policy", [Policy(max_items=5), Policy(max_bytes=1000), Policy(consumers=2)])
def test_any_stated_limit_leaves_age_unlimited(policy: Policy) -> None:
    assert ChannelLimits.of(policy).max_age_nanos is None


def test_only_max_bytes_has_a_default_in_a_policy_with_other_limits() -> None:
    assert ChannelLimits.of(Policy(max_items=5)).max_bytes == 256 * 1024 * 1024


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (Policy(max_age_nanos=0), "max_age is 0"),
        (Policy(max_items=0), "max_items is 0"),
        (Policy(max_bytes=63), "max_bytes is 63"),
        (Policy(max_future_nanos=-1), "max_future is -1"),
        (Policy(max_item_bytes=2**30), f"max_item_bytes is {2**30}"),
        (Policy(on_full="wait"), "on_full is 'wait'"),
        (Policy(consumers=0), "consumers is 0"),
        (Policy(consumers=1025), "consumers is 1025; it must be between 1 and 1024"),
        (Policy(max_items=4, on_full="block"), '"block" without max_age or consumers'),
        (Policy(max_age_unconsumed_nanos=7), "max_age, which it prolongs for consumers that lag, is not stated"),
        (Policy(max_age_nanos=8, max_age_unconsumed_nanos=7), "max_age_unconsumed not below max_age"),
    ],
)
def test_the_error_for_an_invalid_policy_names_the_field(policy: Policy, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        ChannelLimits.of(policy)


def test_on_full_block_is_accepted_with_an_age_that_ends_the_wait() -> None:
    assert ChannelLimits.of(Policy(max_items=4, max_age_nanos=1, on_full="block")).on_full == "block"
    assert ChannelLimits.of(Policy(on_full="block")).max_age_nanos == 10_000_000_000


def test_a_policy_may_block_if_consumers_can_end_the_blocking() -> None:
    limits = ChannelLimits.of(Policy(max_items=4, consumers=2, on_full="block"))
    assert (limits.on_full, limits.max_age_nanos) == ("block", None)
