"""Takes pairs from the group until the cameras have put their ends, and counts every frame without a partner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import stampede_rt as st
from stampede_rt_demos.stereo.camera import NUMBER_ATTRIBUTE
from stampede_rt_demos.stereo.programme import END_NUMBER, TOLERANCE, Side

Pair = tuple[st.Item, st.Item]


@dataclass(slots=True)
class PairAccount:
    """Counts one consumer's matches. `wrong`: pairs of two different frames. `alone`: frames without a partner."""

    pairs: int = 0
    wrong: int = 0
    alone: list[int] = field(default_factory=list)
    dropped: int = 0

    def as_record(self) -> dict[str, Any]:
        """The figures that a role reports."""
        return {"pairs": self.pairs, "wrong": self.wrong, "alone": self.alone, "dropped": self.dropped}


def pairs_of(group: st.Group, per: Side, *, payloads: bool) -> st.MatchSubscription:
    """Return matches for the frames of one camera, also for frames without a partner.

    Call this before the first put, so that the matches include all frames.
    """
    return group.match(per.value, TOLERANCE, partial=True, payloads=payloads)


def take_pairs(matches: st.MatchSubscription, per: Side, handle: Callable[[Pair], None]) -> PairAccount:
    """Pass every pair to `handle`. Blocks until the cameras have put their ends, and all frames have been matched."""
    account = PairAccount()
    for matched in matches:
        number = number_of(matched[per.value])
        if number == END_NUMBER:
            break
        if matched.missing:
            account.alone.append(number)
            continue
        pair = matched[Side.LEFT.value], matched[Side.RIGHT.value]
        account.pairs += 1
        account.wrong += number_of(pair[0]) != number_of(pair[1])
        handle(pair)
    account.dropped = matches.dropped
    return account


def ignore(pair: Pair) -> None:
    """Do nothing with a pair, for a consumer that only counts."""


def number_of(item: st.Item) -> int:
    """Return the number of the frame."""
    return int(item.attributes[NUMBER_ATTRIBUTE])
