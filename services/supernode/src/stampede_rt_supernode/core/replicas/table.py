"""The copies of channels at other hosts, by channel and by host (paper, section 4.1). Pure."""

from __future__ import annotations

from collections.abc import Iterable
from operator import itemgetter

from stampede_rt_supernode.core.records import ReplicaRecord


class ReplicaTable:
    """The replicas of all channels.

    The callers must ensure that a host has at most one replica of a channel, and the channel's owner none. A caller
    that changes the table must change `ChannelRecord.proxy_host_ids` in the same way; see `transitions.store`.
    """

    def __init__(self, replicas: Iterable[ReplicaRecord] = ()) -> None:
        self._by_channel: dict[bytes, tuple[ReplicaRecord, ...]] = {}  # never an empty tuple; in the order of addition
        self._channel_ids_at: dict[bytes, set[bytes]] = {}  # by host id; only hosts that hold a copy
        for replica in replicas:
            self.store(replica.channel_id, (*self.of(replica.channel_id), replica))

    def of(self, channel_id: bytes) -> tuple[ReplicaRecord, ...]:
        """The copies of a channel, in the order of addition."""
        return self._by_channel.get(channel_id, ())

    def entries(self) -> list[tuple[bytes, tuple[ReplicaRecord, ...]]]:
        """The (channel id, its copies) of each channel with a copy, in the order of the ids."""
        return sorted(self._by_channel.items(), key=itemgetter(0))

    def at(self, channel_id: bytes, host_id: bytes) -> ReplicaRecord | None:
        """The copy of a channel at a host; None if there is no copy."""
        return next((one for one in self.of(channel_id) if one.host_id == host_id), None)

    def channel_ids_at(self, host_id: bytes) -> list[bytes]:
        """The channels of which a host holds a copy, ascending."""
        return sorted(self._channel_ids_at.get(host_id, ()))

    def count_at(self, host_id: bytes) -> int:
        """The number of copies that a host holds."""
        return len(self._channel_ids_at.get(host_id, ()))

    def store(self, channel_id: bytes, replicas: tuple[ReplicaRecord, ...]) -> None:
        """Replace all copies of a channel by `replicas`; an empty tuple removes them."""
        for gone in self._by_channel.pop(channel_id, ()):
            held = self._channel_ids_at[gone.host_id]
            held.discard(channel_id)
            if not held:
                del self._channel_ids_at[gone.host_id]
        if replicas:
            self._by_channel[channel_id] = replicas
        for replica in replicas:
            self._channel_ids_at.setdefault(replica.host_id, set()).add(channel_id)

    def __bool__(self) -> bool:
        return bool(self._by_channel)
