"""Calls of hosts and peers to the directory in simulated time: to one supernode after the other."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from stampede_rt.errors import StampedeError
from tests.robustness.directory.world import DirectoryWorld


async def ask(world: DirectoryWorld, method: str, request: Any, seconds: float, *, caller: object) -> Any:
    """Return the answer. Tries one supernode after the other, for `seconds` in all.

    Raises the directory's refusal if a retry would not change it, or a retryable error if no supernode answered in
    time.
    """
    began, deadline = world.now, world.now + seconds
    for member in _members(world, caller):
        left = deadline - world.now
        if left <= 0:
            break
        outcome = await world.call(member, method, request, min(left, 1.5), caller=caller, age_s=world.now - began)
        if not isinstance(outcome, (StampedeError, type(None))):
            world.last_answered[caller] = member
            return outcome
        if world.last_answered.get(caller) is member:
            del world.last_answered[caller]  # the next call begins at another supernode
        if isinstance(outcome, StampedeError) and not outcome.retryable:
            raise outcome
        await world.sleep(0.02 + world.random_source.random() * 0.1)
    raise _NoAnswer("no supernode answered in time")


def _members(world: DirectoryWorld, caller: object) -> Iterator[Any]:
    """The supernodes in the order of the calls.

    The supernode that answered last comes first, as in `stampede_rt_channel_host.cluster.supernodes`.
    """
    members = list(world.members.values())
    last = world.last_answered.get(caller)
    start = members.index(last) if last in members else world.random_source.randrange(len(members))
    return itertools.islice(itertools.cycle(members), start, start + 6 * len(members))


class _NoAnswer(StampedeError):
    """No supernode answered."""

    reason = "NO_QUORUM"
    retryable = True
