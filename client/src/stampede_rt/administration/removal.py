"""Removes a member: asks one supernode after the other, until the leader has removed the member."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from stampede_rt.cluster.majority import UNREACHED
from stampede_rt.errors import DeadlineExceeded, NotLeader, Overloaded, StampedeError, Unavailable
from stampede_rt.v1.directory_pb2 import SupernodeRecord
from stampede_rt.v1.membership_service_pb2 import RemoveSupernodeResponse

CHANGE_SECONDS = 30.0  # the time for which `remove_member` tries again if there is a leader
LEADERLESS_SECONDS = 8.0  # the wait of `remove_member` for a leader; an election takes 4 s at most
BACKOFF_SECONDS = 0.5  # between two tries


def remove_member(
    supernode_id: str,
    known: Sequence[SupernodeRecord],
    addresses: Sequence[str],
    ask: Callable[[str], RemoveSupernodeResponse],
) -> RemoveSupernodeResponse:
    """Ask the supernodes at `addresses` to remove a member, until one does. `known`: the members.

    `ask` makes the call to one address. Raises the leader's error, or Unavailable if there is no leader. If the outcome
    is unknown, the error says so, with the reason AMBIGUOUS.
    """
    began, patience, is_unknown, waiting = time.monotonic(), LEADERLESS_SECONDS, False, list(addresses)
    while waiting:
        try:
            return ask(waiting[0])
        except (NotLeader, Overloaded, Unavailable, DeadlineExceeded) as error:
            is_unknown = is_unknown or _may_have_removed(error)
            leader = error.metadata.get("leader_endpoint")
            patience = CHANGE_SECONDS if leader or isinstance(error, Overloaded) else patience
            if time.monotonic() - began > patience:
                failure = _leaderless(known) if patience == LEADERLESS_SECONDS else error
                raise _unknown_removal(supernode_id, failure) if is_unknown else failure from error
            waiting = [*waiting[1:], waiting[0]]
            if leader:
                waiting = [leader, *(one for one in waiting if one != leader)]
            time.sleep(BACKOFF_SECONDS)
    raise _leaderless(known)


def _leaderless(known: Sequence[SupernodeRecord]) -> Unavailable:
    return Unavailable(
        f"no supernode leads, and only a leader removes a member: start supernodes until {len(known) // 2 + 1} of "
        f"{', '.join(one.supernode_id for one in known)} serve, or, if they are permanently lost, restore the cluster "
        "from the folder of a remaining one, or from a backup (stampede supernode init --restore)"
    )


def _may_have_removed(error: StampedeError) -> bool:
    """Whether a supernode may have put the removal into its log, although the call has failed."""
    if error.from_service:
        return error.reason == "AMBIGUOUS"  # for any other reason the supernode has refused the removal
    return "Connection refused" not in error.metadata.get(UNREACHED, "")


def _unknown_removal(supernode_id: str, failure: StampedeError) -> Unavailable:
    return Unavailable(
        f"it is unknown whether {supernode_id} is removed: {failure.message}. Once a supernode leads, look at "
        f"`stampede supernode status`, and repeat the removal if {supernode_id} is still a member",
        reason="AMBIGUOUS",
    )
