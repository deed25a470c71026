"""One change of the members: the request of a caller, and the change under way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from stampede_rt_supernode.replication.configuration import MEMBERS_MAX, Configuration
from stampede_rt_supernode.replication.interface import (
    ChangeRefused,
    ChangeUnderWay,
    LogUnavailable,
    Member,
    NotLeading,
    OutcomeUnknown,
    TicketSpent,
)

ChangeOutcome = int | OutcomeUnknown | ChangeRefused | ChangeUnderWay | NotLeading | LogUnavailable


@dataclass(slots=True)
class MemberChange:
    """A caller's request to add `member`, or, if `is_removal`, to remove it. The leader calls `done` once.

    In a removal only the id of `member` counts. `ticket`: the ticket that lets the newcomer in; empty if it needs none.
    """

    member: Member
    is_removal: bool
    done: Callable[[ChangeOutcome], None]
    ticket: str = ""


@dataclass(slots=True)
class MemberAddition:
    """A newcomer, and all callers that wait for it. All times are seconds of the node's clock.

    The addition began at `began`, and its present round of catching up at `round_began`. The round ends when the
    newcomer has acknowledged `round_end`. `progress` has last changed at `progress_at`.
    """

    member: Member
    callers: list[MemberChange]
    round_end: int
    round_began: float
    progress_at: float
    began: float
    # (last acknowledged log position, bytes of a snapshot sent to the newcomer)
    progress: tuple[int, int] = (0, 0)


@dataclass(slots=True)
class CommittingChange:
    """A configuration in the log that is not committed yet. It adds or removes the member `member_id`."""

    member_id: str
    log_index: int
    term: int
    callers: list[MemberChange]


def refusal_of_member(configuration: Configuration, member: Member, ticket: str) -> ChangeRefused | None:
    """Return why a newcomer with `ticket` may not join; None if it may. An empty ticket: it needs none."""
    if ticket and configuration.spender_of(ticket) is not None:
        return TicketSpent(f"the token has let {configuration.spender_of(ticket)} join already; make another one")
    if member.member_id in configuration.retired:
        return ChangeRefused(
            f"{member.member_id} was a member before; a removed id is never used again: join under a new one"
        )
    known = configuration.find(member.member_id)
    if known is not None:
        return ChangeRefused(f"{member.member_id} is a member already, at {known.address}; use an id of your own")
    if any(each.address == member.address for each in configuration.members):
        return ChangeRefused(f"{member.address} is the address of another member; remove that one first")
    if len(configuration.members) >= MEMBERS_MAX:
        return ChangeRefused(f"the cluster has {MEMBERS_MAX} members, the limit; remove one first")
    return None
