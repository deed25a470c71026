"""The node's transport without a network: messages come in from an inbox, and leave into an outbox.

Both ends are on the tick thread. Whoever owns the network empties the outbox after each sync, and so nothing
is said before it is on stable storage.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.wire.messages import Message


@dataclass(frozen=True, slots=True)
class Connected:
    """The link to a member is up: from now on it can be sent to."""

    member_id: str


@dataclass(frozen=True, slots=True)
class Disconnected:
    """The link to a member is gone, and all that was queued on it."""

    member_id: str


@dataclass(frozen=True, slots=True)
class StreamOpened:
    """A member has opened a new stream to us: what it sent before and we have not received is lost.

    `highest_level`: the highest feature level that its release knows.
    """

    member_id: str
    highest_level: int = 1


@dataclass(frozen=True, slots=True)
class StreamEnded:
    """A member's stream to us has ended, and no newer one has taken its place."""

    member_id: str


@dataclass(frozen=True, slots=True)
class Received:
    """A checked message from a member."""

    member_id: str
    message: Message
    size_bytes: int = 0


@dataclass(frozen=True, slots=True)
class MembersTold:
    """A member has said, on greeting us, who the members are."""

    member_id: str
    members: tuple[Member, ...]


@dataclass(frozen=True, slots=True)
class Introduced:
    """Somebody unknown has said that it is a member of this cluster, and where it listens."""

    member_id: str
    member: Member


@dataclass(frozen=True, slots=True)
class Disputed:
    """A member has refused our store, and `why`; empty: it takes it."""

    member_id: str
    why: str


NetworkEvent = Connected | Disconnected | StreamOpened | StreamEnded | Received | MembersTold | Introduced | Disputed
Outgoing = tuple[str, Message]


class MemberNode(Protocol):
    """Another member, as the sets and dictionaries of the library hold it."""

    @property
    def id(self) -> str:
        """The member's id."""

    def __hash__(self) -> int:
        """The same in every process."""


class Handler(Protocol):
    """The receiver of the events: a node of the log. `node` is the member that an event is about."""

    def receive(self, node: MemberNode, message: Message) -> None:
        """A member has sent a message."""

    def on_connected(self, node: MemberNode) -> None:
        """Messages to a member leave from now on."""

    def on_disconnected(self, node: MemberNode) -> None:
        """Messages to a member are lost from now on."""

    def on_stream_opened(self, node: MemberNode) -> None:
        """A member has opened a new stream to us."""

    def on_members_told(self, teller_id: str, members: tuple[Member, ...]) -> None:
        """A member has said who the members are."""

    def on_disputed(self, member_id: str, why: str) -> None:
        """A member refuses our store, or, with an empty `why`, takes it again."""

    def on_introduced(self, member: Member) -> None:
        """A stranger has said that it is a member."""


class BufferedTransport:
    """The messages of one node, in and out. Tick thread only."""

    def __init__(self, nodes: Iterable[MemberNode]) -> None:
        # Whom we know: whoever is not in here is neither heard nor sent to.
        self._nodes: dict[str, MemberNode] = {node.id: node for node in nodes}
        # To whom our links are up, known or not: links come and go a little later than members.
        self._connected: set[str] = set()
        # Whose answers reach us at present, likewise.
        self._heard: set[str] = set()
        # The highest feature levels of whoever has opened a stream to us and is still known.
        self.highest_levels: dict[str, int] = {}
        self._outbox: list[Outgoing] = []
        self._handler: Handler | None = None

    def attach(self, handler: Handler) -> None:
        """Hand what comes in to this node; once."""
        self._handler = handler

    def deliver(self, event: NetworkEvent) -> None:
        """Hand one network event to the node; events about strangers are dropped."""
        self._note_links(event)
        if self._handler is None:
            return
        if isinstance(event, Introduced):
            self._handler.on_introduced(event.member)
        elif (node := self._nodes.get(event.member_id)) is not None:
            self._hand_over(self._handler, node, event)

    def _hand_over(self, handler: Handler, node: MemberNode, event: NetworkEvent) -> None:
        match event:
            case Received():
                handler.receive(node, event.message)
            case Connected():
                handler.on_connected(node)
            case Disconnected():
                handler.on_disconnected(node)
            case StreamOpened():
                handler.on_stream_opened(node)
            case Disputed():
                handler.on_disputed(event.member_id, event.why)
            case MembersTold():
                handler.on_members_told(event.member_id, event.members)

    def _note_links(self, event: NetworkEvent) -> None:
        match event:
            case Connected():
                self._connected.add(event.member_id)
            case Disconnected():
                self._connected.discard(event.member_id)
            case StreamOpened():
                self._heard.add(event.member_id)
                self._note_level(event.member_id, event.highest_level)
            case StreamEnded():
                self._heard.discard(event.member_id)

    def _note_level(self, member_id: str, highest_level: int) -> None:
        # A new dictionary: other threads read the one before.
        known = {one: level for one, level in self.highest_levels.items() if one in self._nodes}
        self.highest_levels = {**known, member_id: highest_level}

    def send(self, node: MemberNode, message: Message) -> bool:
        """Queue a message for the next release; False when the member is not connected. Never blocks."""
        if node.id not in self._connected or node.id not in self._nodes:
            return False
        self._outbox.append((node.id, message))
        return True

    def is_reachable(self, member_id: str) -> bool:
        """Whether this member can be asked something: our messages leave, and its answers arrive."""
        return member_id in self._nodes and member_id in self._connected and member_id in self._heard

    def take_outbox(self) -> list[Outgoing]:
        """Everything queued since the last call, in order."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def node(self, member_id: str) -> MemberNode:
        """The node of a member that this node hears. Raises KeyError for others."""
        return self._nodes[member_id]

    def find_node(self, member_id: str) -> MemberNode | None:
        """The node of a member that this node hears; None for others."""
        return self._nodes.get(member_id)

    def add_node(self, node: MemberNode) -> None:
        """Hear and send to one more member."""
        self._nodes[node.id] = node
        if node.id in self._connected and self._handler is not None:
            self._handler.on_connected(node)

    def drop_node(self, node: MemberNode) -> None:
        """Neither hear nor send to this member any more."""
        if self._nodes.pop(node.id, None) is not None and self._handler is not None:
            self._handler.on_disconnected(node)
