"""Several moves with one entry of the log. A host that is drained moves all its channels. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt_supernode.core.moves.commands import (
    CommitMove,
    CommitMoves,
    MovesCommitted,
    MovesReleased,
    MoveToCommit,
    MoveToRelease,
    ReleaseMoves,
)
from stampede_rt_supernode.core.moves.transitions import commit_move
from stampede_rt_supernode.core.records import ChannelRecord, HostRecord, ReplicaKind
from stampede_rt_supernode.core.replicas.transitions import drop_copy
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id, check_incarnation

# The most moves in one entry, so that no entry takes a replica more than a few milliseconds.
MOVES_MAX = 32


def check_commit_moves(operation: CommitMoves) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.to_host_id, "to_host_id")
    check_incarnation(operation.to_boot_incarnation, "to_boot_incarnation")
    check_ids([one.channel_id for one in operation.moves])


def check_release_moves(operation: ReleaseMoves) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.host_id, "host_id")
    check_ids([one.channel_id for one in operation.moves])


def check_ids(channel_ids: Sequence[bytes]) -> None:
    """Raises InvalidArgument for no channels, too many of them, or an id of the wrong length."""
    if not 0 < len(channel_ids) <= MOVES_MAX:
        raise InvalidArgument(
            f"the request names {len(channel_ids)} channels; name 1 to {MOVES_MAX}", metadata={"field": "moves"}
        )
    for one in channel_ids:
        check_id(one, "channel_id")


def commit_moves(tables: Tables, operation: CommitMoves) -> MovesCommitted:
    """Make the host the owner of each channel, unless its epoch has changed."""
    check_commit_moves(operation)
    return MovesCommitted(channels=tuple(_committed(tables, operation)))


def _committed(tables: Tables, operation: CommitMoves) -> Iterator[ChannelRecord]:
    for move in operation.moves:
        with suppress(StampedeError):  # `commit_move` has changed nothing then
            yield commit_move(tables, _alone(operation, move)).channel


def _alone(operation: CommitMoves, move: MoveToCommit) -> CommitMove:
    return CommitMove(
        channel_id=move.channel_id,
        epoch=move.epoch,
        to_host_id=operation.to_host_id,
        to_boot_incarnation=operation.to_boot_incarnation,
        to_registered_index=operation.to_registered_index,
        permit=move.permit,
    )


def release_moves(tables: Tables, operation: ReleaseMoves) -> MovesReleased:
    """Remove the fallbacks of the channels that the host owns at these epochs. Replicas stay."""
    check_release_moves(operation)
    owned = [one for one in operation.moves if _owns(tables, operation.host_id, one)]
    for move in owned:
        for copy in tables.replicas.of(move.channel_id):
            if copy.kind is ReplicaKind.MOVE:
                drop_copy(tables, tables.channels[move.channel_id], copy.host_id)
    return MovesReleased(channel_ids=tuple(one.channel_id for one in owned))


def _owns(tables: Tables, host_id: bytes, move: MoveToRelease) -> bool:
    channel = tables.channels.get(move.channel_id)
    return channel is not None and (channel.host_id, channel.epoch) == (host_id, move.epoch)


def released(tables: Tables, host_id: bytes, channel_ids: Sequence[bytes]) -> list[bytes]:
    """The channels that exist, and that the host neither owns nor has a copy of."""
    check_id(host_id, "host_id")
    check_ids(channel_ids)
    return [
        one
        for one in channel_ids
        if (channel := tables.channels.get(one)) is not None
        and channel.host_id != host_id
        and tables.replicas.at(one, host_id) is None
    ]


def owners(tables: Tables, channel_ids: Sequence[bytes]) -> tuple[list[ChannelRecord], list[HostRecord]]:
    """The channels that exist, and their owners, each once."""
    check_ids(channel_ids)
    channels = [found for one in channel_ids if (found := tables.channels.get(one)) is not None]
    return channels, [tables.hosts[one] for one in dict.fromkeys(channel.host_id for channel in channels)]
