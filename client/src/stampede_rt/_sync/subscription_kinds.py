# Generated from ../_async by tools/generate.py; do not edit.
"""The kinds of subscriptions: over a stream, or by multicast."""

from __future__ import annotations

from stampede_rt._sync.subscription import Subscription
from stampede_rt.errors import InvalidArgument


def kind_of_subscription(via: object) -> type[Subscription]:
    """Return the class for the argument `via`. Raises InvalidArgument, also if the library for it is not installed."""
    if via is None:
        return Subscription
    if via != "multicast":
        raise InvalidArgument(f'via is {via!r}; write "multicast", or leave it out')
    from stampede_rt._sync.multicast_subscription import MulticastSubscription  # needs the extra `multicast`

    return MulticastSubscription
