"""Makes a new cluster from the data of one member of a lost cluster, or from a backup, if the majority is lost.

The new cluster takes over the data of that member or backup. Other data is lost, even if it was acknowledged. The new
cluster has another id, so that an old member that comes back cannot disturb it.
"""

from __future__ import annotations

from pathlib import Path

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import Member, StateMachine
from stampede_rt_supernode.replication.log_entries import COMMAND, CONFIGURATION, Entry
from stampede_rt_supernode.replication.storage.backups import read_backup
from stampede_rt_supernode.replication.storage.sqlite_store import SqliteStore, holds_store, read_identity
from stampede_rt_supernode.replication.storage.store import StoreChanges, StoredState, StoreRefused
from stampede_rt_supernode.replication.wire.records import decode_configuration, decode_snapshot, encode_configuration


def restore_from(source: Path, new_dir: Path, state_machine: StateMachine, *, founder: Member, cluster_id: str) -> int:
    """Write the store of a new cluster into `new_dir`, with the data of `source`.

    Returns the last log position in `source`. `founder` is the only member of the new cluster, whose id is
    `cluster_id`. `source` is a backup, or the data folder of an old member, which must be stopped. `source` stays
    unchanged. First, this function applies all data to `state_machine`, which the caller must not use afterwards. So it
    refuses data that this release cannot read, before it writes anything. Blocks. Raises ReleaseTooOld, StoreRefused,
    StoreDamaged, OSError, or the state machine's errors for an unreadable snapshot.
    """
    if source.is_file():
        header, state = read_backup(source)
        old_member_id = header.member_id
    else:
        old_member_id, state = _read_folder(source)
    _apply(state, state_machine)
    new = SqliteStore(new_dir, cluster_id=cluster_id, member_id=founder.member_id, create=True)
    try:
        new.commit(_changes_of_new_cluster(state, founder, old_member_id))
    finally:
        new.close()
    return state.entries[-1].log_index


def _read_folder(old_dir: Path) -> tuple[str, StoredState]:
    if not old_dir.exists():
        raise StoreRefused(f"{old_dir} does not exist: name a backup, or the data folder of a lost cluster's member")
    if not holds_store(old_dir):
        raise StoreRefused(
            f"{old_dir} is not the data folder of a supernode that has ever run: it has no log; name the folder of a "
            "member of the lost cluster, or a backup that `stampede supernode snapshot` wrote"
        )
    old_cluster_id, old_member_id = read_identity(old_dir)
    old = SqliteStore(old_dir, cluster_id=old_cluster_id, member_id=old_member_id, create=False)
    try:
        state = old.load()
    finally:
        old.close()
    if not state.entries:
        raise StoreRefused(f"{old_dir} has never held anything: there is nothing to restore")
    return old_member_id, state


def _apply(state: StoredState, state_machine: StateMachine) -> None:
    """Apply a stored state. Raises ReleaseTooOld, and the state machine's errors for an unreadable snapshot."""
    covered = 0
    if state.snapshot is not None:
        snapshot = decode_snapshot(state.snapshot.record)
        covered = snapshot.last.log_index
        state_machine.prepare_restore(snapshot.state)()
    for entry in state.entries:
        if entry.log_index > covered and entry.command[0] == COMMAND:
            state_machine.apply(entry.log_index, entry.command[1:])


def _changes_of_new_cluster(state: StoredState, founder: Member, old_member_id: str) -> StoreChanges:
    """The stored state, and an entry that makes `founder` the only member."""
    last = state.entries[-1]
    # A new cluster has no other members, so the votes of the former cluster do not bind it. If a hostile member has
    # raised the term beyond the term of the last entry, the new cluster does not take over the raised term.
    term = last.term + 1
    former = {old_member_id, *(member.member_id for member in _last_members(state))} - {founder.member_id}
    configuration = Configuration.of([founder], retired=sorted(former))
    entry = Entry(encode_configuration(configuration), last.log_index + 1, term)
    return StoreChanges(
        replace_from=0,
        entries=[*state.entries, entry],
        first_index=state.entries[0].log_index,
        last_index=entry.log_index,
        last_term=entry.term,
        term=term,
        voted_for=None,
        commit_index=state.commit_index,
        pieces=list(state.snapshot.pieces()) if state.snapshot else [],
        trailer=state.snapshot.trailer() if state.snapshot else None,
    )


def _last_members(state: StoredState) -> tuple[Member, ...]:
    for entry in reversed(state.entries):
        if entry.command[0] == CONFIGURATION:
            return decode_configuration(entry.command).members
    configuration = decode_snapshot(state.snapshot.record).configuration if state.snapshot else None
    return () if configuration is None else configuration.members
