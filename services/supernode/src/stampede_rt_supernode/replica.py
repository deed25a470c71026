"""The directory as the replicated log drives it: commands and results as bytes, on the log's own thread.

Readers run on the event loop's thread. A lock keeps them from seeing the effect of half a command. No code holds the
lock across an await, and every read under the lock is bounded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from stampede_rt.errors import StampedeError, VersionMismatch
from stampede_rt_supernode.codecs.command_codec import decode_command, encode_result, kind_in, level_needed
from stampede_rt_supernode.codecs.snapshot_codec import SnapshotWriter, decode_snapshot
from stampede_rt_supernode.core.cluster.feature_levels import HIGHEST_LEVEL, may_be_used
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.replication.interface import ReleaseTooOld

T = TypeVar("T")


class DirectoryReplica:
    """A `replication.interface.StateMachine`. `restored` counts how often the whole state was replaced."""

    # The rules of this release about commands. Tests of several releases in one process replace them.
    highest_level = HIGHEST_LEVEL
    level_needed = staticmethod(level_needed)
    kind_in = staticmethod(kind_in)
    decode_command = staticmethod(decode_command)

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._directory = Directory()
        self._snapshots = SnapshotWriter()
        self._listener: Callable[[], None] = _no_listener
        self.restored = 0

    def listen(self, listener: Callable[[], None]) -> None:
        """Call `listener` after every applied command and every restore, on the log's thread. It must not block."""
        self._listener = listener

    def apply(self, index: int, command: bytes) -> bytes:
        """Apply the command at log position `index`. Every replica refuses an unreadable command in the same way.

        Also refuses a command that needs a higher feature level than the cluster's, because members of older releases
        cannot read it. Raises ReleaseTooOld.
        """
        with self._lock:
            try:
                decoded = self.decode_command(command)
                self._check_level(command)
                result = self._directory.apply(index, decoded)
            except StampedeError as error:
                self._directory.skip(index)
                result = RefusedOperation.because(error)
            self._check_release(self._directory)
            encoded = encode_result(result)
            if not isinstance(result, RefusedOperation):
                self._directory.note_done(index, encoded)
        self._listener()
        return encoded

    @property
    def feature_level(self) -> int:
        """The cluster's feature level as of the last applied command. Callable on any thread."""
        return self._directory.feature_level

    def takes(self, command: bytes) -> bool:
        """Whether the command may enter the log.

        Callable on any thread. An answer True stays right, because the cluster's level never falls.
        """
        return may_be_used(self.level_needed(self.kind_in(command)), self.feature_level)

    def _check_level(self, command: bytes) -> None:
        if not self.takes(command):
            raise VersionMismatch(f"the command is not known at feature level {self.feature_level} of the cluster")

    def _check_release(self, directory: Directory) -> None:
        if directory.feature_level > self.highest_level:
            raise ReleaseTooOld(self.highest_level, directory.feature_level)

    def digest(self) -> tuple[int, bytes]:
        """The last applied log position, and a digest of all results up to there. Call it on the log's thread."""
        return self._directory.applied_index, self._directory.digest

    def adopt_digest(self, digest: bytes) -> None:
        """Take over the leader's digest, because this state came from a snapshot without one.

        Call it on the log's thread.
        """
        self._directory.digest = digest

    def begin_snapshot(self) -> Callable[[], bytes]:
        """Copy the whole state as of the last applied command. Returns a function that encodes the copy, on any thread.

        Call that function before the next `begin_snapshot`. Needs no lock, because only this thread changes the state.
        """
        return self._snapshots.begin(self._directory)

    def prepare_restore(self, snapshot: bytes) -> Callable[[], None]:
        """Decode a snapshot, on any thread. Returns a function that replaces the whole state.

        Raises StampedeError for a damaged snapshot, and ReleaseTooOld. The caller must not continue without the
        snapshot.
        """
        directory = decode_snapshot(snapshot)
        self._check_release(directory)

        def restore() -> None:
            # The old state is freed when this function returns, not while readers wait for the lock.
            outdated = self._directory
            with self._lock:
                self._directory, self._snapshots = directory, SnapshotWriter()
                self.restored += 1
            self._listener()
            del outdated

        return restore

    def read(self, query: Callable[[Directory], T]) -> T:
        """The answer of `query`, which gets the state between two commands, and must neither keep nor change it."""
        with self._lock:
            return query(self._directory)


def _no_listener() -> None:
    """The listener before `listen`."""
