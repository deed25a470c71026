"""The replicated state of the simulator and of tests: a list of commands, with checks of the log's promises."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable


class PromiseBroken(AssertionError):
    """The log broke the promise that the message names."""


class History:
    """The facts that all replicas together have shown. Checks every new fact against the earlier ones."""

    def __init__(self) -> None:
        self.command_at: dict[int, bytes] = {}
        self._index_of: dict[bytes, int] = {}
        self._leader_of_term: dict[int, str] = {}
        self.acknowledged: dict[bytes, int] = {}
        self.refused: set[bytes] = set()
        self.highest_acknowledged = 0

    def applied(self, index: int, command: bytes) -> None:
        """Note that a replica applied a command at a position."""
        if self.command_at.setdefault(index, command) != command:
            raise PromiseBroken(f"position {index} holds {self.command_at[index]!r} and {command!r}")
        if self._index_of.setdefault(command, index) != index:
            raise PromiseBroken(f"{command!r} was applied twice, at {self._index_of[command]} and {index}")

    def acknowledge(self, command: bytes, index: int) -> None:
        """Note that the log told a caller the position of its command."""
        if self.command_at.get(index) != command:
            raise PromiseBroken(f"{command!r} was acknowledged at {index}, which holds {self.command_at.get(index)!r}")
        self.acknowledged[command] = index
        self.highest_acknowledged = max(self.highest_acknowledged, index)

    def refuse(self, command: bytes) -> None:
        """Note that the log told a caller that it certainly did not take the command."""
        self.refused.add(command)

    def read(self, *, acknowledged_before: int, index: int) -> None:
        """Note that a confirmed read gave a position. `acknowledged_before`: the highest acknowledged position when the
        read began.
        """
        if index < acknowledged_before:
            raise PromiseBroken(f"a read saw {index}, but {acknowledged_before} was acknowledged before it began")

    def leads(self, member_id: str, term: int) -> None:
        """Note that a replica believes that it leads."""
        if self._leader_of_term.setdefault(term, member_id) != member_id:
            raise PromiseBroken(f"term {term} has two leaders: {self._leader_of_term[term]} and {member_id}")

    def check_end(self, survivors: list[ListMachine]) -> None:
        """Check, after all faults, that all replicas agree, and have all acknowledged and no refused commands."""
        first = survivors[0].entries
        for other in survivors[1:]:
            if other.entries != first:
                raise PromiseBroken("two replicas ended with different commands")
        held = dict(first)
        for command, index in self.acknowledged.items():
            if held.get(index) != command:
                raise PromiseBroken(f"acknowledged {command!r} at {index} is lost")
        for command in self.refused & set(held.values()):
            raise PromiseBroken(f"{command!r} was applied although its caller was told that it was not taken")


class ListMachine:
    """A state machine that remembers every command, and reports to a history."""

    highest_level = feature_level = 1

    def __init__(self, history: History | None = None) -> None:
        self.entries: list[tuple[int, bytes]] = []
        self._history = history or History()
        self._digest = b""

    def takes(self, command: bytes) -> bool:
        """Always true: every release knows these commands."""
        return True

    def apply(self, index: int, command: bytes) -> bytes:
        """Append, and answer with the position."""
        if self.entries and index <= self.entries[-1][0]:
            raise PromiseBroken(f"position {index} was applied after {self.entries[-1][0]}")
        self._history.applied(index, command)
        self.entries.append((index, command))
        self._chain(index, command)
        return b"%d" % index

    def _chain(self, index: int, command: bytes) -> None:
        self._digest = hashlib.blake2b(self._digest + b"%d" % index + command, digest_size=16).digest()

    def digest(self) -> tuple[int, bytes]:
        """The last position, and a digest of all commands."""
        return (self.entries[-1][0] if self.entries else 0), self._digest

    def adopt_digest(self, digest: bytes) -> None:
        """Take over the leader's digest."""
        self._digest = digest

    def snapshot(self) -> bytes:
        """The encoded list of commands."""
        return json.dumps([[index, command.decode()] for index, command in self.entries]).encode()

    def begin_snapshot(self) -> Callable[[], bytes]:
        """Copy the list of commands. Returns a function that encodes the copy."""
        copied = ListMachine()
        copied.entries = self.entries[:]
        return copied.snapshot

    def prepare_restore(self, snapshot: bytes) -> Callable[[], None]:
        """Decode a list of commands. The returned function checks it, and replaces the list by it."""
        entries = [(index, text.encode()) for index, text in json.loads(snapshot)]

        def restore() -> None:
            self.entries, self._digest = entries[:], b""
            for index, command in entries:
                self._history.applied(index, command)
                self._chain(index, command)

        return restore


NEWER_COMMAND = b"a command of newer releases"


class OlderListMachine(ListMachine):
    """A machine of a release that does not know the command NEWER_COMMAND, and refuses it."""

    _refused_at = 0

    def apply(self, index: int, command: bytes) -> bytes:
        """Apply a command like every other machine, but refuse NEWER_COMMAND."""
        if command != NEWER_COMMAND:
            return super().apply(index, command)
        self._refused_at = index
        return b"refused"

    def digest(self) -> tuple[int, bytes]:
        """As of every machine. A refused command counts as applied, and changes nothing."""
        index, digest = super().digest()
        return max(index, self._refused_at), digest
