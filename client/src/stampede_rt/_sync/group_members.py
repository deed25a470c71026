# Generated from ../_async by tools/generate.py; do not edit.
"""The members of a group as one process knows them, shared by the group's handle and its subscriptions."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.reader import Reader
from stampede_rt._sync.session import CALL_TIMEOUT_S, Session, request_id
from stampede_rt.errors import GroupNotFound, InvalidArgument, StampedeError
from stampede_rt.handles import Reference
from stampede_rt.transports.concurrency_sync import monotonic_s, run_all
from stampede_rt.v1 import group_directory_service_pb2 as group_directory_pb
from stampede_rt.values.grouping import GroupInfo, NamedChannel, SeenCut, is_named_by, shown_name
from stampede_rt.wire.groups import group_info, group_spec


class GroupMembers(Reference):
    """The members of a group, as the directory last described them, and the latest cut that this process has seen.

    `create`: whether the program stated the members when it opened the group. If so, and if the directory begins anew,
    `refresh` creates the group again.
    """

    def __init__(self, session: Session, info: GroupInfo, channels: Sequence[Channel], create: bool) -> None:
        self.session = session
        self.info = info
        self.channels = tuple(channels)
        self.view = SeenCut(info.group_id)
        self._create = create
        self._cluster_id = session.supernodes.cluster_id

    def __len__(self) -> int:
        return len(self.channels)

    def __reduce__(self) -> tuple[Any, ...]:
        codings = [(one.name, one._state.coding) for one in self.channels if one._state.coding is not None]
        return self.session.reopened("group_members", self.name, codings)

    @property
    def name(self) -> str:
        """The group's name."""
        return self.info.name

    @property
    def incarnation(self) -> int:
        """The group's incarnation, as last known."""
        return self.info.incarnation

    def explained(self, error: StampedeError) -> StampedeError:
        """Add the group's name to an error, because a host names only the group's id. Returns the error."""
        error.concerning("group", self.name)
        return error

    def refresh(self, known: Sequence[Channel] = ()) -> None:
        """Ask the directory for the present members. Raises GroupNotFound, Unavailable."""
        request = group_directory_pb.ResolveGroupRequest(group_id=self.info.group_id)
        response: group_directory_pb.ResolveGroupResponse | group_directory_pb.OpenGroupResponse
        try:
            response = self.session.supernodes.call("ResolveGroup", request, CALL_TIMEOUT_S)
        except GroupNotFound:
            response = self._open_again()
        info = group_info(response.group)
        if info.incarnation != self.incarnation:
            self.view.cut_floor = None
        self.view.group_id = info.group_id
        self.channels = member_handles(self.session, response, [*self.channels, *known])
        self.info = info

    def _open_again(self) -> group_directory_pb.OpenGroupResponse:
        """Open the group by its name, because the directory does not know its id any more.

        Creates the group if the directory itself began anew. Raises GroupNotFound.
        """
        supernodes = self.session.supernodes
        request = group_directory_pb.OpenGroupRequest(request_id=request_id(), name=self.name)
        begun_anew = supernodes.present_cluster(monotonic_s() + CALL_TIMEOUT_S) != self._cluster_id
        if self._create and begun_anew:
            reference = [one for one in self.channels if one.info.channel_id == self.info.reference_id]
            self.forget_bindings()
            self.targets()  # opens the members by their names, so that they have the ids of the new directory
            spec = group_spec(
                [one.info.channel_id for one in self.channels],
                reference[0].info.channel_id if reference else None,
                self.info.bound,
                self.info.idle_after_nanos,
                self.info.max_lead_nanos,
            )
            request.spec.CopyFrom(spec)
            request.create = True
        try:
            response: group_directory_pb.OpenGroupResponse = supernodes.call("OpenGroup", request, CALL_TIMEOUT_S)
        except GroupNotFound as error:
            raise self.explained(error) from None
        self._cluster_id = supernodes.cluster_id
        return response

    def targets(self) -> list[str]:
        """Return the addresses of the hosts that own members, each once."""
        bindings = run_all([functools.partial(self.session.place, one._state) for one in self.channels])
        return list(dict.fromkeys(binding.target for binding in bindings))

    def forget_bindings(self) -> None:
        """Make the next request look for the members' hosts again."""
        for channel in self.channels:
            self.session.cache.forget(channel.info.channel_id)

    def member(self, channel: NamedChannel | str) -> Channel:
        """Return the handle of the member that `channel` names. `channel` is a name, a handle or a descriptor.

        Raises InvalidArgument for a channel that is not a member.
        """
        for member in self.channels:
            if is_named_by(channel, member):
                return member
        members = ", ".join(member.name for member in self.channels)
        raise InvalidArgument(
            f"{shown_name(channel)!r} is not a member of the group {self.name!r}, whose members are {members}"
        )


def member_handles(
    session: Session,
    response: group_directory_pb.OpenGroupResponse | group_directory_pb.ResolveGroupResponse,
    known: Sequence[Reader],
) -> tuple[Channel, ...]:
    """Return handles of a group's members. `known` are handles and descriptors, whose codecs the new handles keep."""
    hosts = {host.host_id: host for host in response.hosts}
    kept = (one if isinstance(one, Channel) else Channel(session, one._state) for one in known)
    handles = {channel.info.channel_id: channel for channel in kept}
    return tuple(
        handles.get(record.channel_id) or Channel(session, session.found(record, hosts.get(record.host_id)))
        for record in response.channels
    )
