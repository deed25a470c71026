"""The log lines of a front-end about supernodes: one for each change, not one for each probe. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from stampede_rt_frontend.roster import SupernodeRoster

# The time in which the parts of a cluster start.
START_SECONDS = 5.0


class LogLine(NamedTuple):
    """One line of the log, with the name of its event.

    `is_well`: the line reports a good state. `is_return`: the line reports the end of a bad state that an earlier line
    has reported.
    """

    event: str
    text: str
    is_well: bool
    is_return: bool
    facts: dict[str, str]


class StatusLog:
    """Compares the states of the supernodes with the states that it reported last.

    All parts of a cluster may start at the same time. For the first START_SECONDS the log therefore does not report
    a supernode that could not serve yet.
    """

    def __init__(self) -> None:
        self._starts_until_s: float | None = None  # the end of the first START_SECONDS; None before the first call
        self._served: dict[str, bool] = {}  # by target: whether the supernode could serve, as reported last
        # Whether any supernode could serve, as reported last; None: not reported yet.
        self._any_served: bool | None = None

    def changes(self, roster: SupernodeRoster, now_s: float) -> Iterator[LogLine]:
        """A line for each change since the last call. `now_s` is read from a clock that never goes back."""
        if self._starts_until_s is None:
            self._starts_until_s = now_s + START_SECONDS
        is_starting = now_s < self._starts_until_s
        states = roster.states()
        served = {target: self._served[target] for target in states if target in self._served}
        for target, why in states.items():
            if why is not None and is_starting and target not in served:
                continue
            if served.get(target) is not (why is None):
                yield _supernode_line(target, why, is_return=target in served and why is None)
            served[target] = why is None
        self._served = served
        yield from self._directory_changes(roster.any_healthy(), knows_all=len(served) == len(roster.targets()))

    def _directory_changes(self, any_serves: bool, *, knows_all: bool) -> Iterator[LogLine]:
        """A line if the directory can serve now or no longer. `knows_all`: the state of each supernode is known."""
        if any_serves is not self._any_served and (any_serves or knows_all):
            is_return = any_serves and self._any_served is not None
            self._any_served = any_serves
            yield _directory_line(any_serves, is_return=is_return)


def _supernode_line(target: str, why: str | None, *, is_return: bool) -> LogLine:
    facts = {"supernode": target} if why is None else {"supernode": target, "why": why}
    return LogLine(
        event="supernode_serves" if why is None else "supernode_cannot_serve",
        text="a supernode can serve" if why is None else "a supernode cannot serve",
        is_well=why is None,
        is_return=is_return,
        facts=facts,
    )


def _directory_line(any_serves: bool, *, is_return: bool) -> LogLine:
    none_serves = "no supernode can serve this front-end: no client can connect through it until one can"
    return LogLine(
        event="directory_serves" if any_serves else "directory_cannot_serve",
        text="the directory can serve: callers can connect" if any_serves else none_serves,
        is_well=any_serves,
        is_return=is_return,
        facts={},
    )
