"""The library's transport without a network: messages in from an inbox, out into an outbox.

Both ends are on the tick thread. Whoever owns the network empties the outbox after each sync, and so nothing
is said before it is on stable storage.
"""

# The camelCase names are the library's.
# ruff: noqa: N802

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.wire.codec import Message, encode_message


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
    """A member has opened a new stream to us: what it sent before and we have not received is lost."""

    member_id: str


@dataclass(frozen=True, slots=True)
class StreamEnded:
    """A member's stream to us has ended, and no newer one has taken its place."""

    member_id: str


@dataclass(frozen=True, slots=True)
class Received:
    """A checked message from a member."""

    member_id: str
    message: Message


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


NetworkEvent = Connected | Disconnected | StreamOpened | StreamEnded | Received | MembersTold | Introduced
Outgoing = tuple[str, pb.RaftMessage]
NodeCallback = Callable[[Any], None]


class Mailroom:
    """Stands where the library expects its TCP transport. Tick thread only."""

    ready = True

    def __init__(self, nodes: Iterable[Any]) -> None:
        # Whom we know: whoever is not in here is neither heard nor sent to.
        self._nodes: dict[str, Any] = {node.id: node for node in nodes}
        # To whom our links are up, known or not: links come and go a little later than members.
        self._connected: set[str] = set()
        # Whose answers reach us at present, likewise.
        self._heard: set[str] = set()
        self._outbox: list[Outgoing] = []
        self._on_message: Callable[[Any, Message], None] | None = None
        self._on_connected: NodeCallback | None = None
        self._on_disconnected: NodeCallback | None = None
        # Called when a member has opened a new stream.
        self.on_stream_opened: NodeCallback = lambda node: None
        # Called when a member has said who the members are.
        self.on_members_told: Callable[[tuple[Member, ...]], None] = lambda members: None
        # Called when a stranger has said that it is a member.
        self.on_introduced: Callable[[Member], None] = lambda member: None
        # Stamped on every append message; the replies echo it (see rules/reads.py).
        self.round = 0

    def deliver(self, event: NetworkEvent) -> None:
        """Hand one network event to the library; events about strangers are dropped."""
        self._note_links(event)
        if isinstance(event, Introduced):
            self.on_introduced(event.member)
            return
        node = self._nodes.get(event.member_id)
        if node is None or not (self._on_message and self._on_connected and self._on_disconnected):
            return
        match event:
            case Received():
                self._on_message(node, event.message)
            case Connected():
                self._on_connected(node)
            case Disconnected():
                self._on_disconnected(node)
            case StreamOpened():
                self.on_stream_opened(node)
            case MembersTold():
                self.on_members_told(event.members)

    def _note_links(self, event: NetworkEvent) -> None:
        match event:
            case Connected():
                self._connected.add(event.member_id)
            case Disconnected():
                self._connected.discard(event.member_id)
            case StreamOpened():
                self._heard.add(event.member_id)
            case StreamEnded():
                self._heard.discard(event.member_id)

    def send(self, node: Any, message: Message) -> bool:
        """Queue a message for the next release; False when the member is not connected. Never blocks."""
        if node.id not in self._connected or node.id not in self._nodes:
            return False
        if message["type"] == "append_entries":
            message["round"] = self.round
        self._outbox.append((node.id, encode_message(message)))
        return True

    def is_reachable(self, member_id: str) -> bool:
        """Whether this member can be asked something: our messages leave, and its answers arrive."""
        return member_id in self._nodes and member_id in self._connected and member_id in self._heard

    def take_outbox(self) -> list[Outgoing]:
        """Everything queued since the last call, in order."""
        outbox, self._outbox = self._outbox, []
        return outbox

    def setOnMessageReceivedCallback(self, callback: Callable[[Any, Message], None]) -> None:
        """Called by the library once."""
        self._on_message = callback

    def setOnNodeConnectedCallback(self, callback: NodeCallback) -> None:
        """Called by the library once."""
        self._on_connected = callback

    def setOnNodeDisconnectedCallback(self, callback: NodeCallback) -> None:
        """Called by the library once."""
        self._on_disconnected = callback

    def setOnReadonlyNodeConnectedCallback(self, callback: NodeCallback) -> None:
        """There are no anonymous read-only peers: they could forge appends."""

    def setOnReadonlyNodeDisconnectedCallback(self, callback: NodeCallback) -> None:
        """There are no anonymous read-only peers."""

    def setOnUtilityMessageCallback(self, message: str, callback: Callable[..., None]) -> None:
        """The library's remote administration is never reached."""

    def node(self, member_id: str) -> Any:
        """The node with this id, None for a stranger."""
        return self._nodes.get(member_id)

    def addNode(self, node: Any) -> None:
        """Hear and send to one more member."""
        self._nodes[node.id] = node
        if node.id in self._connected and self._on_connected is not None:
            self._on_connected(node)

    def dropNode(self, node: Any) -> None:
        """Neither hear nor send to this member any more."""
        if self._nodes.pop(node.id, None) is not None and self._on_disconnected is not None:
            self._on_disconnected(node)

    def destroy(self) -> None:
        """Forget what was not released."""
        self._outbox.clear()
