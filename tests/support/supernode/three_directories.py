"""Three directories for the property tests. They get the same commands, and must stay equal."""

from __future__ import annotations

from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from stampede_rt_supernode.codecs.command_codec import decode_command, encode_command, encode_result
from stampede_rt_supernode.codecs.snapshot_codec import SnapshotWriter, decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.cluster.commands import MarkTime
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation, Result
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.kept_answers import KeptAnswers
from tests.support.supernode.operations import id_of


class ThreeDirectories(RuleBasedStateMachine):
    """`directory` gets values, `twin` gets encoded bytes, and `restored` is sometimes replaced by its own snapshot."""

    def __init__(self) -> None:
        super().__init__()
        self.directory, self.twin, self.restored = Directory(), Directory(), Directory()
        self.index = 0
        self.drawn = 0
        self.writer = SnapshotWriter()

    def fresh_id(self) -> bytes:
        self.drawn += 1
        return id_of(1000 + self.drawn)

    def apply(self, operation: Operation, op_id: bytes, skip: int = 1) -> Result:
        as_of_index = max(0, self.index - self.drawn % 4)
        self.index += skip
        command = Command(op_id=op_id, time_unix_nano=0, operation=operation, as_of_index=as_of_index)
        before = encode_snapshot(self.directory)
        result = self.directory.apply(self.index, command)
        redecoded = decode_command(encode_command(command))
        assert encode_result(self.twin.apply(self.index, redecoded)) == encode_result(result)
        assert encode_result(self.restored.apply(self.index, command)) == encode_result(result)
        if isinstance(result, RefusedOperation):
            assert self.without_index(before) == self.without_index(encode_snapshot(self.directory))
        return result

    @staticmethod
    def without_index(snapshot: bytes) -> Directory | bytes:
        directory = decode_snapshot(snapshot)
        directory.tables.index = 0
        directory.kept_answers = KeptAnswers()  # each command forgets a few answers
        return encode_snapshot(directory)

    @rule()
    def mark_time(self) -> None:
        """Apply a leader's mark of time. Afterwards commands of callers may be too late."""
        marks = self.directory.kept_answers.last_mark
        self.apply(MarkTime(tenure=self.directory.tenure, after_index=marks), self.fresh_id())

    @rule()
    def restore(self) -> None:
        self.restored = decode_snapshot(encode_snapshot(self.restored))

    @invariant()
    def all_replicas_agree(self) -> None:
        assert encode_snapshot(self.directory) == encode_snapshot(self.twin) == encode_snapshot(self.restored)
        assert self.writer.begin(self.directory)() == encode_snapshot(self.directory), "a kept part is outdated"
