"""The messages and requests that other threads hand to a replica, for its next step. All queues have bounds."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import TypeVar

from stampede_rt_supernode.replication.interface import LogUnavailable
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver
from stampede_rt_supernode.replication.rules.member_change import MemberChange
from stampede_rt_supernode.replication.rules.proposals import Proposal
from stampede_rt_supernode.replication.rules.snapshot_requests import SnapshotRequest
from stampede_rt_supernode.replication.settings import COMMAND_BYTES_MAX, ReplicationSettings
from stampede_rt_supernode.replication.wire.buffered_transport import MessageReceived, NetworkEvent

# The most changes of the members, and the most requests for a snapshot, that wait.
CHANGES_MAX = 100
SNAPSHOT_REQUESTS_MAX = 10

T = TypeVar("T")


class InboxFull(RuntimeError):
    """Too many messages of one member wait. This replica must drop the stream of that member."""


class Arrivals:
    """The waiting messages and requests. Any thread adds to them. Only the tick thread takes from them."""

    def __init__(self, settings: ReplicationSettings) -> None:
        self._settings = settings
        self._inbox = _InboxShares(settings.inbox_items_max, settings.inbox_bytes_max)
        self.events: deque[NetworkEvent] = deque()
        self.proposals: deque[Proposal] = deque()
        self.reads: deque[ConfirmedRead] = deque()
        self.changes: deque[MemberChange | HandOver] = deque()
        self.snapshot_requests: deque[SnapshotRequest] = deque()

    def add_event(self, event: NetworkEvent) -> None:
        """Queue a network event. Raises InboxFull if too many messages of that member wait. Other events always fit."""
        if isinstance(event, MessageReceived):
            self._inbox.count_received(event)
        self.events.append(event)

    def add_proposal(self, proposal: Proposal) -> None:
        """Queue a command. Raises LogUnavailable if too many wait, ValueError if it is too large."""
        if len(proposal.command) > COMMAND_BYTES_MAX:
            raise ValueError(f"a command of {len(proposal.command)} bytes is over the limit of {COMMAND_BYTES_MAX}")
        if len(self.proposals) >= self._settings.proposals_max:
            raise LogUnavailable(f"{self._settings.proposals_max} commands wait already: slow down and try again")
        self.proposals.append(proposal)

    def add_read(self, read: ConfirmedRead) -> None:
        """Queue a confirmed read. Raises LogUnavailable if too many wait."""
        if len(self.reads) >= self._settings.reads_max:
            raise LogUnavailable(f"{self._settings.reads_max} reads wait already: slow down and try again")
        self.reads.append(read)

    def add_change(self, change: MemberChange | HandOver) -> None:
        """Queue a change of the members, or a hand-over. Raises LogUnavailable if too many wait."""
        if len(self.changes) >= CHANGES_MAX:
            raise LogUnavailable(f"{CHANGES_MAX} changes of the members wait already: try again in a while")
        self.changes.append(change)

    def add_snapshot_request(self, request: SnapshotRequest) -> None:
        """Queue a request for a snapshot. Raises LogUnavailable if too many wait."""
        if len(self.snapshot_requests) >= SNAPSHOT_REQUESTS_MAX:
            raise LogUnavailable(f"{SNAPSHOT_REQUESTS_MAX} wait for a snapshot already: try again in a while")
        self.snapshot_requests.append(request)

    def take_events(self) -> Iterator[NetworkEvent]:
        """The waiting events, in order. Events that come during the call wait for the next call."""
        for event in taken_from(self.events):
            if isinstance(event, MessageReceived):
                self._inbox.count_taken(event)
            yield event


def taken_from(queue: deque[T]) -> Iterator[T]:
    """The present entries of `queue`, in order. Each one is removed as it is given."""
    for _ in range(len(queue)):
        yield queue.popleft()


class _InboxShares:
    """Counts the waiting messages of each member. Each member has a share, so that none fills the share of another.

    The thread that adds messages counts the added messages. The tick thread counts the messages that it has taken. So
    each counter has only one writer.
    """

    def __init__(self, items_max: int, bytes_max: int) -> None:
        self._items_max, self._bytes_max = items_max, bytes_max
        self._arrived: dict[str, tuple[int, int]] = {}
        self._taken: dict[str, tuple[int, int]] = {}

    def count_received(self, event: MessageReceived) -> None:
        """Count a message that came. Raises InboxFull if the member has too many waiting messages."""
        items, size = self._arrived.get(event.member_id, (0, 0))
        items_out, size_out = self._taken.get(event.member_id, (0, 0))
        if items - items_out >= self._items_max or size - size_out >= self._bytes_max:
            raise InboxFull(f"{items - items_out} messages of {event.member_id} wait for the log's thread")
        self._arrived[event.member_id] = items + 1, size + event.size_bytes

    def count_taken(self, event: MessageReceived) -> None:
        """Count a message that was taken."""
        items, size = self._taken.get(event.member_id, (0, 0))
        self._taken[event.member_id] = items + 1, size + event.size_bytes
