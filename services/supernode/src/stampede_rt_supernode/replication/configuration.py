"""The configurations of the cluster: its members as the log states them. Pure.

One member is added or removed at a time. Then any majority before the change and any majority after it share a member.
So two leaders of one term cannot both have a majority (Ongaro's dissertation, section 4.1). A configuration takes
effect when it is added to the log, before it is committed. PySyncObj's own guard against two simultaneous changes never
takes effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from stampede_rt_supernode.replication.interface import Member

MEMBERS_MAX = 9
# A configuration remembers this many ids of former members and this many used tickets: the latest of each.
RETIRED_MAX = 512
SPENT_MAX = 512


@dataclass(frozen=True, slots=True)
class Configuration:
    """The members in the order of their ids, the ids of former members, and the used tickets."""

    members: tuple[Member, ...]
    retired: tuple[str, ...] = ()
    # Pairs of a ticket (the hash of a join token) and the id of the member that it has let in. Each ticket lets in one
    # member.
    spent: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(
        cls, members: Sequence[Member], retired: Sequence[str] = (), spent: Sequence[tuple[str, str]] = ()
    ) -> Configuration:
        """The configuration of these members."""
        return cls(tuple(sorted(members, key=lambda member: member.member_id)), tuple(retired), tuple(spent))

    def spender_of(self, ticket: str) -> str | None:
        """The id of the member that a ticket has let in; None if the ticket was not used."""
        return dict(self.spent).get(ticket)

    def find(self, member_id: str) -> Member | None:
        """The member with this id; None if no member has it."""
        return next((member for member in self.members if member.member_id == member_id), None)

    def with_member(self, member: Member, ticket: str = "") -> Configuration:
        """The configuration with one more member, let in with or without a ticket."""
        spent = (*self.spent, (ticket, member.member_id)) if ticket else self.spent
        return Configuration.of((*self.members, member), self.retired, spent[-SPENT_MAX:])

    def without(self, member_id: str) -> Configuration:
        """The configuration without one member. No member may join under this id as long as it is among `retired`."""
        remaining = [member for member in self.members if member.member_id != member_id]
        return Configuration.of(remaining, (*self.retired, member_id)[-RETIRED_MAX:], self.spent)


class ConfigurationChange(NamedTuple):
    """A configuration, and the log position from which it is in effect."""

    log_index: int
    configuration: Configuration


class Configurations:
    """A base, and the configurations in the log's entries after it.

    The base is the configuration that was in effect before these entries. The entries up to its position are never cut
    off. Invariant: the positions ascend.
    """

    def __init__(self, base: Configuration) -> None:
        self._changes = [ConfigurationChange(0, base)]
        # Grows whenever the list of configurations changes.
        self.version = 0

    @property
    def current(self) -> Configuration:
        """The configuration that is in effect now."""
        return self._changes[-1].configuration

    @property
    def current_index(self) -> int:
        """The log position of the current configuration; for the base, the end of its snapshot, or 0 without one."""
        return self._changes[-1].log_index

    def at(self, log_index: int) -> Configuration:
        """The configuration that was in effect at a position; the base for a position before the base."""
        return next(change.configuration for change in reversed(self._changes) if self._is_at(change, log_index))

    def _is_at(self, change: ConfigurationChange, log_index: int) -> bool:
        return change.log_index <= log_index or change is self._changes[0]

    def note(self, log_index: int, configuration: Configuration) -> None:
        """Note a configuration that was added to the log."""
        self._changes.append(ConfigurationChange(log_index, configuration))
        self.version += 1

    def cut_from(self, log_index: int) -> None:
        """Drop the configurations at or after a position, because their entries were cut off. The base stays."""
        kept = [change for change in self._changes[1:] if change.log_index < log_index]
        if len(kept) + 1 != len(self._changes):
            self._changes[1:] = kept
            self.version += 1

    def rebase(self, log_index: int, configuration: Configuration) -> None:
        """Set the base to the configuration that was in effect at the end of a snapshot. Later configurations stay."""
        later = [change for change in self._changes[1:] if change.log_index > log_index]
        self._changes = [ConfigurationChange(log_index, configuration), *later]
        self.version += 1

    def known_members(self) -> list[Member]:
        """All members of these configurations, each with its newest address."""
        members = {member.member_id: member for change in self._changes for member in change.configuration.members}
        return list(members.values())
