"""The refusals of this member by others, and when they are confirmed. Pure.

A refusing member may be mistaken, or lie. While any member refuses this one's store, this one does not vote, because it
might have forgotten its promises. If others say that its release is too old, it still votes, because its store is
sound. Either refusal ends this member if the leader that it follows says so, or most of the other members.
"""

from __future__ import annotations

from collections.abc import Collection
from enum import Enum

from stampede_rt_supernode.replication.interface import TOO_OLD
from stampede_rt_supernode.replication.network.hello import (
    ANOTHER_STORE,
    NO_STORE,
    OLDER_STORE,
    REMOVED,
)


class Grounds(Enum):
    """The grounds of a refusal that lasts until a person acts, each with the words that refusals contain."""

    REMOVED = REMOVED
    ANOTHER_STORE = ANOTHER_STORE
    OLDER_STORE = OLDER_STORE
    NO_STORE = NO_STORE
    TOO_OLD = TOO_OLD


def grounds_of(why: str) -> Grounds | None:
    """The grounds of a refusal; None if it may end by itself."""
    return next((grounds for grounds in Grounds if grounds.value in why), None)


class Refusals:
    """The members that refuse this member's store or release at present, and the confirmed refusal.

    On one thread only.
    """

    def __init__(self) -> None:
        # member id -> its words
        self.by: dict[str, str] = {}
        # the confirmed grounds, and the words
        self.confirmed: Grounds | None = None
        self.why = ""

    def refused(self, member_id: str, why: str, *, others: Collection[str], leader_id: str | None) -> bool:
        """Note a refusal. Returns whether it is confirmed now. `others`: every other member."""
        self.by[member_id] = why
        trusted = [leader_id] if leader_id in self.by else sorted(one for one in self.by if one in others)
        if self.confirmed is None and (trusted == [leader_id] or 2 * len(trusted) > len(others)):
            words = self.by[trusted[0] or ""]
            self.confirmed, self.why = grounds_of(words), f"{words} (says {', '.join(map(str, trusted))})"
        return self.confirmed is not None

    def accepted(self, member_id: str) -> bool:
        """Note that a member accepts this one. Returns whether it refused before."""
        return self.by.pop(member_id, None) is not None
