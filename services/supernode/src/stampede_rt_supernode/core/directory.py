"""The directory: a state machine driven by the replicated log (paper, section 4.3). Pure.

The same commands at the same positions give the same state and the same results on every replica. The directory reads
no clock and no random numbers: commands carry such values. The result of an invalid command is a refusal, and no
exception is raised.
"""

from __future__ import annotations

from hashlib import blake2b

from stampede_rt.errors import StampedeError
from stampede_rt_supernode.core.cluster.feature_levels import GROUPS_AND_PEERS_LEVEL
from stampede_rt_supernode.core.command_kinds import CommandKind
from stampede_rt_supernode.core.command_table import kind_of, subject_of
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation, Result, Success
from stampede_rt_supernode.core.kept_answers import KeptAnswer
from stampede_rt_supernode.core.state import DIGEST_BYTES, DirectoryState
from stampede_rt_supernode.core.validation import check_id


class Directory(DirectoryState):
    """The state, and the effect of the log on it. `command_table` defines the effect of each kind of command."""

    def apply(self, index: int, command: Command) -> Result:
        """Apply the command at log position `index`. Positions grow and may skip numbers. A refusal changes nothing."""
        self.tables.begin(index)
        self.kept_answers.forget_some()
        try:
            return self._answer(index, command)
        except StampedeError as error:
            return RefusedOperation.because(error)
        finally:
            self.tables.note_index(index)

    def note_done(self, index: int, result: bytes) -> None:
        """Add the encoded result of the operation at log position `index` to `digest`, unless the digest is unknown.

        Do not call it for refusals, because their texts differ between releases.
        """
        if self.digest:
            done = self.digest + index.to_bytes(8, "big") + result
            self.digest = blake2b(done, digest_size=DIGEST_BYTES).digest()

    def skip(self, index: int) -> None:
        """Note a log position with an entry that this replica could not read."""
        self.tables.note_index(index)

    def _answer(self, index: int, command: Command) -> Success:
        check_id(command.op_id, "request_id")
        kind: CommandKind[Operation, Success] = kind_of(command.operation)
        subject = subject_of(command.operation)
        found = self.kept_answers.find(command.op_id, subject)
        if found is not None:
            return found
        if not kind.is_remembered:
            return kind.apply(self, command.operation, command.time_unix_nano)
        self.kept_answers.check_not_late(command.as_of_index)
        caller = command.caller if self.feature_level >= GROUPS_AND_PEERS_LEVEL else ""
        if kind.needs_room:
            self.kept_answers.check_room(caller)
        kind.check_not_late(self, command.operation, command.as_of_index)
        result = kind.apply(self, command.operation, command.time_unix_nano)
        self.kept_answers.remember(KeptAnswer(command.op_id, index, subject, result, caller))
        return result
