"""The refusals of this member by others, and when they hold. Pure.

One of them may be mistaken, or lie. While any refuses its store, this member does not vote: it might have forgotten
what it has promised. A release that is said to be too old does not hold its vote back: its store is sound. Either ends
this member by the word of the leader whom it follows, or of most of the others.
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
    """On which a member is refused until somebody acts, each with the words by which a refusal tells it."""

    REMOVED = REMOVED
    ANOTHER_STORE = ANOTHER_STORE
    OLDER_STORE = OLDER_STORE
    NO_STORE = NO_STORE
    TOO_OLD = TOO_OLD


def grounds_of(why: str) -> Grounds | None:
    """The grounds of a refusal; None if it may be over in a moment."""
    return next((grounds for grounds in Grounds if grounds.value in why), None)


class Refusals:
    """The members that refuse this member's store, or its release, at present, and the confirmed refusal. On one thread
    only."""

    def __init__(self) -> None:
        # Member id -> its words.
        self.by: dict[str, str] = {}
        # What holds for good, and the words.
        self.confirmed: Grounds | None = None
        self.why = ""

    def refused(self, member_id: str, why: str, *, others: Collection[str], leader_id: str | None) -> bool:
        """A member refuses this one; whether that is confirmed by now. `others`: every other member."""
        self.by[member_id] = why
        trusted = [leader_id] if leader_id in self.by else sorted(one for one in self.by if one in others)
        if self.confirmed is None and (trusted == [leader_id] or 2 * len(trusted) > len(others)):
            words = self.by[trusted[0] or ""]
            self.confirmed, self.why = grounds_of(words), f"{words} (says {', '.join(map(str, trusted))})"
        return self.confirmed is not None

    def accepted(self, member_id: str) -> bool:
        """A member takes this one; whether it did not before."""
        return self.by.pop(member_id, None) is not None
