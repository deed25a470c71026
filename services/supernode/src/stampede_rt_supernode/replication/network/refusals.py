"""The refusals of this member by others, and when they are confirmed. Pure.

A refusing member may be mistaken, or lie. While any member refuses this member's store, this member does not vote,
because it might have forgotten votes or entries. If others say that its release is too old, it still votes, because its
store is sound. A refusal of either kind is confirmed, and ends this member, if it comes from the leader that this
member follows, or from most of the other members.
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


class RefusalGrounds(Enum):
    """The grounds of a refusal that lasts until a person acts, each with the words that refusals contain."""

    REMOVED = REMOVED
    ANOTHER_STORE = ANOTHER_STORE
    OLDER_STORE = OLDER_STORE
    NO_STORE = NO_STORE
    TOO_OLD = TOO_OLD


def grounds_of(why: str) -> RefusalGrounds | None:
    """The grounds of a refusal; None if it may end by itself."""
    return next((grounds for grounds in RefusalGrounds if grounds.value in why), None)


class Refusals:
    """The members that refuse this member's store or release at present, and the confirmed refusal.

    Use it on one thread only.
    """

    def __init__(self) -> None:
        # member id -> the words with which the member refuses this member
        self.words_by_id: dict[str, str] = {}
        # the grounds and words of the confirmed refusal; None and empty as long as there is none
        self.confirmed: RefusalGrounds | None = None
        self.why = ""

    def refused(self, member_id: str, why: str, *, others: Collection[str], leader_id: str | None) -> bool:
        """Note a refusal. Returns whether this or an earlier refusal is confirmed.

        `others`: the ids of all other members. `leader_id`: the leader that this member follows; None if it knows none.
        """
        self.words_by_id[member_id] = why
        trusted = (
            [leader_id] if leader_id in self.words_by_id else sorted(one for one in self.words_by_id if one in others)
        )
        if self.confirmed is None and (trusted == [leader_id] or 2 * len(trusted) > len(others)):
            words = self.words_by_id[trusted[0] or ""]
            self.confirmed, self.why = grounds_of(words), f"{words} (says {', '.join(map(str, trusted))})"
        return self.confirmed is not None

    def accepted(self, member_id: str) -> bool:
        """Note that a member accepts this member. Returns whether the other member refused this member before."""
        return self.words_by_id.pop(member_id, None) is not None
