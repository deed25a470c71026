"""The members, and how they follow from the log. Pure.

One member comes or goes at a time: any majority of the members before and any of those after then share a member, so
that two leaders of one term cannot both find one (Ongaro's dissertation, section 4.1). A configuration holds from the
moment it is in the log, committed or not; PySyncObj's own guard against two changes at once never takes effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from stampede_rt_supernode.replication.interface import Member

MEMBERS_MAX = 9
RETIRED_MAX = 512
SPENT_MAX = 512


@dataclass(frozen=True, slots=True)
class Configuration:
    """Every member, in the order of ids, and the ids that were members once."""

    members: tuple[Member, ...]
    retired: tuple[str, ...] = ()
    # (ticket, member id): a ticket lets one member in.
    spent: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(
        cls, members: Sequence[Member], retired: Sequence[str] = (), spent: Sequence[tuple[str, str]] = ()
    ) -> Configuration:
        """The configuration of these members."""
        return cls(tuple(sorted(members, key=lambda member: member.member_id)), tuple(retired), tuple(spent))

    def spender_of(self, ticket: str) -> str | None:
        """The member that a ticket has let in."""
        return dict(self.spent).get(ticket)

    def find(self, member_id: str) -> Member | None:
        """The member with this id."""
        return next((member for member in self.members if member.member_id == member_id), None)

    def with_member(self, member: Member, ticket: str = "") -> Configuration:
        """The configuration with one member more, let in by a ticket, or without one."""
        spent = (*self.spent, (ticket, member.member_id)) if ticket else self.spent
        return Configuration.of((*self.members, member), self.retired, spent[-SPENT_MAX:])

    def without(self, member_id: str) -> Configuration:
        """The configuration with one member less, whose id never comes back."""
        remaining = [member for member in self.members if member.member_id != member_id]
        return Configuration.of(remaining, (*self.retired, member_id)[-RETIRED_MAX:], self.spent)


class ConfigurationChange(NamedTuple):
    """A configuration and the log position from which it holds."""

    log_index: int
    configuration: Configuration


class Configurations:
    """The configurations in the log that is held, and the one before it.

    Invariant: positions grow; the first is the base, at or before the log's first entry that can still be cut off.
    """

    def __init__(self, base: Configuration) -> None:
        self._changes = [ConfigurationChange(0, base)]
        # Grows with everything that may have changed the current configuration.
        self.version = 0

    @property
    def current(self) -> Configuration:
        """The one that holds now."""
        return self._changes[-1].configuration

    @property
    def current_index(self) -> int:
        """The log position of the current one; 0 when it is not from the log."""
        return self._changes[-1].log_index

    def at(self, log_index: int) -> Configuration:
        """The one that held at a position, for positions at or past the base."""
        return next(change.configuration for change in reversed(self._changes) if self._is_at(change, log_index))

    def _is_at(self, change: ConfigurationChange, log_index: int) -> bool:
        return change.log_index <= log_index or change is self._changes[0]

    def note(self, log_index: int, configuration: Configuration) -> None:
        """A configuration was added to the log."""
        self._changes.append(ConfigurationChange(log_index, configuration))
        self.version += 1

    def cut_from(self, log_index: int) -> None:
        """The log's entries from a position on were cut off."""
        kept = [change for change in self._changes[1:] if change.log_index < log_index]
        if len(kept) + 1 != len(self._changes):
            self._changes[1:] = kept
            self.version += 1

    def rebase(self, log_index: int, configuration: Configuration) -> None:
        """A snapshot up to a position says which one held there; later ones stay."""
        later = [change for change in self._changes[1:] if change.log_index > log_index]
        self._changes = [ConfigurationChange(log_index, configuration), *later]
        self.version += 1

    def known_members(self) -> list[Member]:
        """Everybody whom one of them names; the newest address of each."""
        members = {member.member_id: member for change in self._changes for member in change.configuration.members}
        return list(members.values())
