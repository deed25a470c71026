"""The incarnations of which a channel has items, and the losses between them. Pure.

If the owner of a channel is lost, and a replica that may lack its latest items becomes the owner, the channel continues
under a new incarnation with the items of the replica.
"""

from __future__ import annotations

from typing import NamedTuple

FORMER_MAX = 16
"""The most former incarnations that a channel knows. The items of earlier ones have no valid positions any more."""


class FormerIncarnation(NamedTuple):
    """A former incarnation: its items before the seq `next_seq` are there, and later ones are lost."""

    incarnation: int
    next_seq: int


LostPlaces = tuple[FormerIncarnation, ...]
"""The losses that a reader does not know yet, the earliest first. If an archive shows a loss, `incarnation` is the
present one, and `next_seq` is the first seq of the owner after the loss."""


class Losses(NamedTuple):
    """The items that a channel has lost with former owners.

    The host accepted all lost items before the instant `before`; None: no item was lost. `since`: no item before that
    instant was lost; None: any item may be lost. `former`: the former incarnations of which there are items, the
    earliest first.
    """

    before: int | None = None
    since: int | None = None
    former: tuple[FormerIncarnation, ...] = ()

    def after(self, incarnation: int, next_seq: int, newest: int | None, now: int) -> Losses:
        """The losses after one more loss at `now`: the items of `incarnation` from the seq `next_seq` on are lost.

        `newest`: the time of the newest item that is there; None: the lost items may have any time.
        """
        known = [one._replace(next_seq=min(one.next_seq, next_seq)) for one in self.former]
        since = newest
        if self.before is not None:
            since = None if newest is None or self.since is None else min(newest, self.since)
        return Losses(now, since, (*known, FormerIncarnation(incarnation, next_seq))[-FORMER_MAX:])

    @property
    def inherited_next_seq(self) -> int | None:
        """The items before this seq were there when the present incarnation began; None: it began without items."""
        return self.former[-1].next_seq if self.former else None

    def from_incarnation(self, incarnation: int) -> tuple[FormerIncarnation, ...]:
        """The losses that a reader of this incarnation does not know yet, the earliest first."""
        at = next((at for at, one in enumerate(self.former) if one.incarnation == incarnation), len(self.former))
        return self.former[at:]
