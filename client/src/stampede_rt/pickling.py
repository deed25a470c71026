"""Passing connections and handles to another process: what is pickled is where the cluster is, and the thing's name.

The secret never is. Where it comes from a file, the other process finds it as `connect` does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.connection import Connection
from stampede_rt._sync.group import Group
from stampede_rt._sync.group_channel import GroupChannel
from stampede_rt._sync.group_members import GroupMembers
from stampede_rt._sync.queue import Queue
from stampede_rt._sync.queue_locator import open_queue, queue_state
from stampede_rt._sync.session import Session
from stampede_rt.cluster.connecting import Target, parse_target
from stampede_rt.security.tls import TlsFiles
from stampede_rt.values.codecs import Coding
from stampede_rt.values.model import Policy
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt.values.timeline import DurationLike

_sessions: WeakValueDictionary[ClusterReference, Session] = WeakValueDictionary()  # of handles that came from elsewhere


@dataclass(frozen=True, slots=True)
class ClusterReference:
    """How another process reaches the same cluster."""

    frontends: tuple[str, ...]
    zone: str
    tls: TlsFiles | None
    secret_is_an_argument: bool = False

    @classmethod
    def of(cls, target: Target, secret: str | None) -> ClusterReference:
        """Of a connection; `secret` as its maker stated it."""
        return cls(target.frontends, target.zone, target.tls.files if target.tls else None, secret is not None)

    def __reduce__(self) -> tuple[Callable[..., ClusterReference], tuple[Any, ...]]:
        if self.secret_is_an_argument:
            raise TypeError(
                "a connection whose secret was an argument of connect() cannot be pickled, nor what was opened with "
                "it: the secret would be written down; name a file of it in $STAMPEDE_SECRET_FILE instead"
            )
        return ClusterReference, (self.frontends, self.zone, self.tls)

    def connection(self) -> Connection:
        """A connection of the other process' own."""
        return Connection(self._connect(), "")

    def channel(self, name: str, stated: Policy, create: bool, coding: Coding | None) -> Channel:
        """A channel's handle, as it was opened."""
        session = self._session()
        info = session.open_channel(name, stated, None, create)
        return Channel(session, session.state_of(info, stated, create, coding))

    def group_members(self, name: str, codings: Sequence[tuple[str, Coding]]) -> GroupMembers:
        """What a group's handle and its descriptors share; `codings`: the codecs of its members, by name."""
        members = Connection(self._session(), "").group(name)._members
        by_name = dict(codings)
        for channel in members.channels:
            channel._state.coding = by_name.get(channel.name)
        return members

    def group(self, members: GroupMembers) -> Group:
        """A group's handle."""
        return Group(members)

    def descriptor(self, members: GroupMembers, name: str, coding: Coding | None) -> GroupChannel:
        """A group's descriptor of a channel."""
        descriptor = Group(members)[name]
        descriptor._state.coding = coding
        return descriptor

    def queue(
        self,
        name: str,
        stated: QueuePolicy,
        create: bool,
        coding: Coding | None,
        prefetch: int,
        reconnect: DurationLike | None,
    ) -> Queue:
        """A queue's handle, as it was opened."""
        session = self._session()
        info = open_queue(session, name, stated, None, create)
        return Queue(session, queue_state(session, name, info, stated, create, coding), prefetch, reconnect)

    def _session(self) -> Session:
        """The one that all handles from elsewhere share in this process."""
        session = _sessions.get(self)
        if session is None or session.closed or session.inherited:
            session = _sessions[self] = self._connect()
        return session

    def _connect(self) -> Session:
        target = parse_target(",".join(self.frontends), name=None, secret=None, zone=self.zone, tls=self.tls)
        session = Session(target.frontends, target.credentials, peer_name=target.name, zone=target.zone, reopening=self)
        try:
            session.open()
        except BaseException:
            session.close()
            raise
        return session
