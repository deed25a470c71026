"""The directory as the replicated log drives it: bytes in, bytes out, from the log's own thread.

Readers live on the event loop's thread. A short lock keeps them from seeing half of a command; nobody holds it across
an await, and every read under it is bounded.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from stampede_rt.errors import StampedeError
from stampede_rt_supernode.codecs.command_codec import decode_command, encode_result
from stampede_rt_supernode.codecs.snapshot_codec import SnapshotWriter, decode_snapshot
from stampede_rt_supernode.core.commands import Refused
from stampede_rt_supernode.core.directory import Directory

T = TypeVar("T")


class DirectoryReplica:
    """A `replication.interface.StateMachine`. `restored` counts how often the state was replaced as a whole."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._directory = Directory()
        self._snapshots = SnapshotWriter()
        self._listener: Callable[[], None] = _nobody
        self.restored = 0

    def listen(self, listener: Callable[[], None]) -> None:
        """Call `listener` after every applied command and every restore, on the log's thread; it must not block."""
        self._listener = listener

    def apply(self, index: int, command: bytes) -> bytes:
        """Apply the command at log position `index`; what cannot be read is refused, alike on every replica."""
        with self._lock:
            try:
                result = self._directory.apply(index, decode_command(command))
            except StampedeError as error:
                self._directory.skip(index)
                result = Refused.because(error)
            encoded = encode_result(result)
            if not isinstance(result, Refused):
                self._directory.note_done(index, encoded)
        self._listener()
        return encoded

    def digest(self) -> tuple[int, bytes]:
        """The last log position applied, and a digest of all that was done up to there; on the log's thread."""
        return self._directory.applied_index, self._directory.digest

    def begin_snapshot(self) -> Callable[[], bytes]:
        """The whole state, as of the last applied command, to be encoded by any thread; one at a time.

        No lock is needed: only this thread changes it.
        """
        return self._snapshots.begin(self._directory)

    def prepare_restore(self, snapshot: bytes) -> Callable[[], None]:
        """Decode it, on any thread, and return what replaces the whole state.

        Raises for a damaged snapshot: going on without it would answer wrongly.
        """
        directory = decode_snapshot(snapshot)

        def restore() -> None:
            outdated = self._directory  # freed when this returns: not while readers wait for the lock
            with self._lock:
                self._directory, self._snapshots = directory, SnapshotWriter()
                self.restored += 1
            self._listener()
            del outdated

        return restore

    def read(self, question: Callable[[Directory], T]) -> T:
        """The answer of `question`, which sees the state between two commands, and must neither keep nor change it."""
        with self._lock:
            return question(self._directory)


def _nobody() -> None:
    """Nobody listens yet."""
