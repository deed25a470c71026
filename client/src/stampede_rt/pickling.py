"""Pickles connections and handles for other processes. A pickle has the cluster's address and the name of the thing.

A pickle never contains the secret. The other process finds the secret as `connect` does, for example in a file.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
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
from stampede_rt.values.codecs import HandleCodec
from stampede_rt.values.model import Policy
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt.values.timeline import DurationLike

_sessions: WeakValueDictionary[ClusterReference, Session] = WeakValueDictionary()  # for unpickled handles


@dataclass(frozen=True, slots=True)
class ClusterReference:
    """The arguments with which another process connects to the same cluster.

    `secret_is_an_argument`: the program gave the secret itself to `connect`. Such a reference cannot be pickled.
    `secret_path`: the path of a secret that the program gave to `connect`; empty if it gave none.
    """

    frontends: tuple[str, ...]
    zone: str
    tls: TlsFiles | None
    secret_path: str = ""
    secret_is_an_argument: bool = False
    transport: str | None = None

    @classmethod
    def of(
        cls, target: Target, secret: str | os.PathLike[str] | None, transport: str | None = None
    ) -> ClusterReference:
        """Return the reference of a connection. `secret` and `transport` are the arguments of `connect`."""
        tls = target.tls.files if target.tls else None
        path = "" if secret is None or isinstance(secret, str) else os.path.abspath(secret)
        return cls(target.frontends, target.zone, tls, path, isinstance(secret, str), transport)

    def __reduce__(self) -> tuple[Callable[..., ClusterReference], tuple[Any, ...]]:
        if self.secret_is_an_argument:
            raise TypeError(
                "a connection with a secret as argument of connect() cannot be pickled, nor can its handles: the "
                "pickle would have the secret; give connect() the path of the secret's file instead"
            )
        return ClusterReference, (self.frontends, self.zone, self.tls, self.secret_path, False, self.transport)

    def connection(self) -> Connection:
        """Return a new connection to the cluster. Unpickling a connection calls this in the other process."""
        return Connection(self._connect(), "")

    def channel(self, name: str, stated: Policy, create: bool, coding: HandleCodec | None) -> Channel:
        """Return a channel's handle, opened with the same arguments as the pickled handle."""
        session = self._session()
        info = session.open_channel(name, stated, None, create)
        return Channel(session, session.state_of(info, stated, create, coding))

    def group_members(self, name: str, codings: Sequence[tuple[str, HandleCodec]]) -> GroupMembers:
        """Return the members of a group, for the group's handle and its descriptors.

        `codings`: the codecs of the members, by the names of the members.
        """
        members = Connection(self._session(), "").group(name)._members
        by_name = dict(codings)
        for channel in members.channels:
            channel._state.coding = by_name.get(channel.name)
        return members

    def group(self, members: GroupMembers) -> Group:
        """Return a group's handle."""
        return Group(members)

    def descriptor(self, members: GroupMembers, name: str, coding: HandleCodec | None) -> GroupChannel:
        """Return a group's descriptor of the channel named `name`."""
        descriptor = Group(members)[name]
        descriptor._state.coding = coding
        return descriptor

    def queue(
        self,
        name: str,
        stated: QueuePolicy,
        create: bool,
        coding: HandleCodec | None,
        prefetch: int,
        reconnect: DurationLike | None,
    ) -> Queue:
        """Return a queue's handle, opened with the same arguments as the pickled handle."""
        session = self._session()
        info = open_queue(session, name, stated, None, create)
        return Queue(session, queue_state(session, name, info, stated, create, coding), prefetch, reconnect)

    def _session(self) -> Session:
        """Return the session that all unpickled handles of a cluster share in this process."""
        session = _sessions.get(self)
        if session is None or session.closed or session.inherited:
            session = _sessions[self] = self._connect()
        return session

    def _connect(self) -> Session:
        secret = Path(self.secret_path) if self.secret_path else None
        target = parse_target(
            ",".join(self.frontends), name=None, secret=secret, zone=self.zone, tls=self.tls, transport=self.transport
        )
        session = Session(
            target.frontends,
            target.credentials,
            peer_name=target.name,
            zone=target.zone,
            transport=target.transport,
            reopening=self,
        )
        try:
            session.open()
        except BaseException:
            session.close()
            raise
        return session
