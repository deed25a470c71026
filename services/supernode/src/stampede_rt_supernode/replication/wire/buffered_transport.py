"""The node's transport, without a network: events come in through `deliver`, and messages leave through an outbox.

Both ends are on the tick thread. The replica empties the outbox after each sync of the log. So no message leaves before
its contents are on stable storage.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.wire.messages import Message


@dataclass(frozen=True, slots=True)
class LinkConnected:
    """The link to a member is up: messages can be sent to it."""

    member_id: str


@dataclass(frozen=True, slots=True)
class LinkDisconnected:
    """The link to a member is gone, with all messages queued on it."""

    member_id: str


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """A member has opened a new stream to this member. Messages of its former stream that did not arrive are lost.

    `highest_level`: the highest feature level that the member's release knows.
    """

    member_id: str
    highest_level: int = 1


@dataclass(frozen=True, slots=True)
class StreamEnded:
    """A member's stream to this member has ended, and no newer stream has replaced it."""

    member_id: str


@dataclass(frozen=True, slots=True)
class MessageReceived:
    """A checked message from a member."""

    member_id: str
    message: Message
    size_bytes: int = 0


@dataclass(frozen=True, slots=True)
class MembersReported:
    """A member has sent its list of the members, in an answer on the stream to it."""

    member_id: str
    members: tuple[Member, ...]


@dataclass(frozen=True, slots=True)
class NodeIntroduced:
    """An unknown node has said that it is a member of this cluster, and its address."""

    member_id: str
    member: Member


@dataclass(frozen=True, slots=True)
class StoreDisputed:
    """A member refuses this node's store, for the reason `why`. If `why` is empty, that member accepts it again."""

    member_id: str
    why: str


NetworkEvent = (
    LinkConnected
    | LinkDisconnected
    | StreamOpened
    | StreamEnded
    | MessageReceived
    | MembersReported
    | NodeIntroduced
    | StoreDisputed
)
# The id of the receiver, and the message.
Outgoing = tuple[str, Message]


class MemberNode(Protocol):
    """Another member, as it stands in the library's sets and dictionaries."""

    @property
    def id(self) -> str:
        """The member's id."""

    def __hash__(self) -> int:
        """A hash that is the same in every process."""


class EventHandler(Protocol):
    """The receiver of the events: a node of the log. `node` is the member concerned."""

    def receive(self, node: MemberNode, message: Message) -> None:
        """A member has sent a message."""

    def on_connected(self, node: MemberNode) -> None:
        """Messages to a member can be sent from now on."""

    def on_disconnected(self, node: MemberNode) -> None:
        """Messages to a member are lost from now on."""

    def on_stream_opened(self, node: MemberNode) -> None:
        """A member has opened a new stream to this node."""

    def on_members_reported(self, reporter_id: str, members: tuple[Member, ...]) -> None:
        """A member has sent its view of the members."""

    def on_disputed(self, member_id: str, why: str) -> None:
        """A member refuses this node's store, or, with an empty `why`, accepts it again."""

    def on_introduced(self, member: Member) -> None:
        """An unknown node has said that it is a member."""


class BufferedTransport:
    """The incoming and outgoing messages of one node. Tick thread only."""

    def __init__(self, nodes: Iterable[MemberNode]) -> None:
        # The known members. The node neither accepts messages of other nodes nor sends to them.
        self._nodes: dict[str, MemberNode] = {node.id: node for node in nodes}
        # Members to which there is a link. They may be unknown, because links come and go a little later than members.
        self._connected: set[str] = set()
        # Members, known or not, that have a stream to this node. Their answers arrive over it.
        self._senders: set[str] = set()
        # By member id: the highest feature level of the member's release, as it said when it opened a stream.
        self.highest_levels: dict[str, int] = {}
        self._outbox: list[Outgoing] = []
        self._handler: EventHandler | None = None

    def attach(self, handler: EventHandler) -> None:
        """Pass incoming events to this node. Call it once."""
        self._handler = handler

    def deliver(self, event: NetworkEvent) -> None:
        """Pass one network event to the node. Drops every event about an unknown member, except NodeIntroduced."""
        self._note_links(event)
        if self._handler is None:
            return
        if isinstance(event, NodeIntroduced):
            self._handler.on_introduced(event.member)
        elif (node := self._nodes.get(event.member_id)) is not None:
            self._dispatch(self._handler, node, event)

    def _dispatch(self, handler: EventHandler, node: MemberNode, event: NetworkEvent) -> None:
        match event:
            case MessageReceived():
                handler.receive(node, event.message)
            case LinkConnected():
                handler.on_connected(node)
            case LinkDisconnected():
                handler.on_disconnected(node)
            case StreamOpened():
                handler.on_stream_opened(node)
            case StoreDisputed():
                handler.on_disputed(event.member_id, event.why)
            case MembersReported():
                handler.on_members_reported(event.member_id, event.members)

    def _note_links(self, event: NetworkEvent) -> None:
        match event:
            case LinkConnected():
                self._connected.add(event.member_id)
            case LinkDisconnected():
                self._connected.discard(event.member_id)
            case StreamOpened():
                self._senders.add(event.member_id)
                self._note_level(event.member_id, event.highest_level)
            case StreamEnded():
                self._senders.discard(event.member_id)

    def _note_level(self, member_id: str, highest_level: int) -> None:
        # A new dictionary, because other threads read the former one.
        known = {one: level for one, level in self.highest_levels.items() if one in self._nodes}
        self.highest_levels = {**known, member_id: highest_level}

    def send(self, node: MemberNode, message: Message) -> bool:
        """Queue a message for the next release. Returns False if the member is not connected. Never blocks."""
        if node.id not in self._connected or node.id not in self._nodes:
            return False
        self._outbox.append((node.id, message))
        return True

    def is_reachable(self, member_id: str) -> bool:
        """Whether this member can answer: messages to it can be sent, and its answers arrive."""
        return member_id in self._nodes and member_id in self._connected and member_id in self._senders

    def take_outbox(self) -> list[Outgoing]:
        """The messages queued since the last call, in order."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def node(self, member_id: str) -> MemberNode:
        """The node of a member whose messages this node accepts. Raises KeyError for other members."""
        return self._nodes[member_id]

    def find_node(self, member_id: str) -> MemberNode | None:
        """The node of a member whose messages this node accepts; None for other members."""
        return self._nodes.get(member_id)

    def add_node(self, node: MemberNode) -> None:
        """Receive from one more member, and send to it."""
        self._nodes[node.id] = node
        if node.id in self._connected and self._handler is not None:
            self._handler.on_connected(node)

    def drop_node(self, node: MemberNode) -> None:
        """Receive nothing from this member, and send nothing to it any more."""
        if self._nodes.pop(node.id, None) is not None and self._handler is not None:
            self._handler.on_disconnected(node)
