"""Remembers the id of each member's store, because a member that lost its disk must not come back under its old id.

Such a member has forgotten its vote and the entries that it acknowledged. It could vote for a leader that lacks these
entries. Its own empty store does not show the loss. But the others remember the id of its former store. They also
remember the term and entries that it has reported (`store.Promise`), and so recognise an older copy of its store. If
the refusal of a member for one of these reasons is confirmed, the member notes that in its own folder, and does not
start again.
"""

from __future__ import annotations

import json
import os
import secrets
import threading
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from stampede_rt_supernode.replication.storage.store import REJOIN, StoreDamaged

FILE_NAME = "replicated_log.stores"
# The most nodes that are remembered although they are not members.
OTHERS_MAX = 32
# The length of the random id of a new store. In the file and in hellos the id is in hexadecimal.
ID_BYTES = 8
# The longest store id that this member accepts in a hello.
STORE_ID_BYTES_MAX = 64


class KnownStores:
    """The ids of the members' stores, as one member remembers them in the file FILE_NAME of its data folder.

    A member without a data folder remembers no ids, and its own store has no id.

    Callable on any thread.
    """

    def __init__(
        self, own: str = "", known: Mapping[str, str] | None = None, path: Path | None = None, refused: str = ""
    ) -> None:
        # The id of this member's own store; empty without a folder.
        self.own = own
        # Why others refuse this store; empty as long as they accept it.
        self.refused = refused
        self._known = dict(known or {})
        self._path = path
        self._mutex = threading.Lock()  # two members may come together, and the file must hold both

    @classmethod
    def open(cls, data_dir: Path | None, *, had_store: bool) -> KnownStores:
        """Read the notes in the folder. Begins new notes if there are none, or if the store is new (not `had_store`).

        Blocks. Raises StoreDamaged or OSError.
        """
        if data_dir is None:
            return cls()
        path = data_dir / FILE_NAME
        if had_store and path.exists():
            facts = _read(path.read_bytes(), path)
            return cls(facts["own"], facts["known"], path, facts.get("refused", ""))
        known = cls(secrets.token_hex(ID_BYTES), {}, path)
        known._write()
        return known

    def admits(self, member_id: str, store_id: str) -> bool:
        """Whether a member may come with this store: the member is new, or came with the same store before.

        An empty `store_id` means no store. A member that has come with a store must keep that store.
        """
        return self._known.get(member_id, store_id) == store_id

    def note_own_refusal(self, why: str) -> None:
        """Note in the file that the others refuse this member's own store. Blocks. Raises OSError."""
        with self._mutex:
            self.refused = why
            if self._path is not None:
                self._write()

    def note(self, member_id: str, store_id: str, members: Collection[str]) -> None:
        """Remember the store of an admitted member, also after restarts. Blocks if the member is new. Raises OSError.

        `members`: the ids of the members in the log. Of the nodes that are not members, only the last OTHERS_MAX are
        remembered.
        """
        with self._mutex:
            if self._path is None or not store_id or member_id in self._known:
                return
            self._known[member_id] = store_id
            others = [known for known in self._known if known not in members]
            for oldest in others[:-OTHERS_MAX]:
                del self._known[oldest]
            self._write()

    def _write(self) -> None:
        """Write the file, whole or not at all."""
        assert self._path is not None
        body = json.dumps({"own": self.own, "known": self._known, "refused": self.refused})
        draft = self._path.with_name(f".{FILE_NAME}.{secrets.token_hex(4)}")
        descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "w") as file:
            file.write(f"{zlib.crc32(body.encode()):08x} {body}\n")
            file.flush()
            os.fsync(file.fileno())
        draft.replace(self._path)
        force_folder(self._path.parent)


def _read(content: bytes, path: Path) -> dict[str, Any]:
    checksum, _, body = content.rstrip(b"\n").partition(b" ")
    if checksum != b"%08x" % zlib.crc32(body):
        raise StoreDamaged(f"{path} fails its checksum: {REJOIN}")
    try:
        facts: dict[str, Any] = json.loads(body)
        if _is_sound(facts):
            return facts
        raise ValueError("it names no stores")
    except (ValueError, RecursionError) as error:
        raise StoreDamaged(f"{path} cannot be read ({error}): {REJOIN}") from error


def _is_sound(facts: Any) -> bool:
    if not isinstance(facts, dict) or not isinstance(facts.get("known"), dict):
        return False
    return all(isinstance(text, str) for text in (facts.get("own"), facts.get("refused", ""), *facts["known"].values()))


def force_folder(folder: Path) -> None:
    """Force the names of the files in a folder to the disk. Blocks."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
