"""The outgoing half of the network: a link to every other member, and the refusals that come back over them."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Callable, Collection, Mapping, Sequence

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.network.hello import OTHER_CLUSTER
from stampede_rt_supernode.replication.network.peer_link import Dial, Introduce, PeerLink
from stampede_rt_supernode.replication.network.refusals import RefusalGrounds, Refusals, grounds_of
from stampede_rt_supernode.replication.network.reports import ReportLimiter
from stampede_rt_supernode.replication.raft_replica import MemberRoster
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.threads.loop_bridge import LoopBridge
from stampede_rt_supernode.replication.wire.buffered_transport import (
    LinkConnected,
    NetworkEvent,
    Outgoing,
    StoreDisputed,
)
from stampede_rt_supernode.replication.wire.codec import encode_message

logger = logging.getLogger(__name__)

# The shortest time between two rounds of new hellos to the others. Without this pause one refusing member could make
# this member restart its streams all the time.
ASK_OTHERS_SECONDS = 5.0
# Two beginnings of a sentence in the warning about an unconfirmed refusal. The sentence goes on with "once ...".
OUTDATED_FOLLOWS = "This member goes on, but ends"
REFUSED_FOLLOWS = "This member goes on as a follower without a vote, but ends"
# The leader queues more entries and pieces of a snapshot on a link only while fewer bytes than this wait there.
ROOM_BYTES = 4 << 20

# The text before the words of a refusal in the reason that a link reports: the status code, and perhaps "refused: ".
_STATUS = re.compile(r"^(refused: )?(StatusCode\.)?[A-Z_]+: ")

# How often `close` cancels the links that have not ended, and how long it waits for them each time.
CANCELLATIONS_MAX = 5
CANCEL_AGAIN_SECONDS = 1.0


class PeerLinks:
    """The links to all members that a replica knows: the RaftNetwork over gRPC."""

    def __init__(
        self,
        settings: ReplicationSettings,
        dial: Dial,
        bridge: LoopBridge,
        on_fatal: Callable[[BaseException], None],
    ) -> None:
        self._settings = settings
        self._dial = dial
        self._bridge = bridge
        self._on_fatal = on_fatal
        self._links: dict[str, PeerLink] = {}
        self._reports = ReportLimiter()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        # The tasks of dropped links that have not ended yet.
        self._ending: set[asyncio.Task[None]] = set()
        self._deliver: Callable[[NetworkEvent], None] | None = None
        self._introduce: Introduce | None = None
        # The members that refuse this member until a person acts, and their reasons.
        self.refusals = Refusals()
        # When this member last asked the others whether they accept it, on the monotonic clock.
        self._others_asked_at = float("-inf")
        # The words of a member of another cluster; empty if there was none.
        self.other_cluster = ""
        # The members that say that this release does not know the cluster's feature level.
        self.outdated = Refusals()
        # Returns the ids of the other members according to the log, and the id of the leader that this member follows.
        self.others_and_leader: Callable[[], tuple[Collection[str], str | None]] = lambda: ((), None)
        # Called once, with the reason, if others refuse this member and will always refuse it. The call blocks: it
        # writes a small file.
        self.on_refusal_confirmed: Callable[[str], None] = lambda why: None
        # Called with the id of a member that breaks the protocol, and the text of the fault.
        self.on_protocol_fault: Callable[[str, str], None] = lambda member_id, why: None

    def start(self, deliver: Callable[[NetworkEvent], None], peers: Mapping[str, Member], introduce: Introduce) -> None:
        """Begin to connect to every peer, with the hellos of `introduce`. Call it on the loop."""
        self._deliver, self._introduce = deliver, introduce
        self._follow(peers)

    def follow(self, roster: MemberRoster) -> None:
        """Connect to the peers of `roster` and to no others. Called on the tick thread."""
        self._bridge.post(lambda: self._follow(roster.peers))

    def _follow(self, peers: Mapping[str, Member]) -> None:
        if self._deliver is None or self._introduce is None:
            return  # `start` was not called yet, or `close` was
        for member_id, link in list(self._links.items()):
            if peers.get(member_id) != link.member:
                del self._links[member_id]
                task = self._tasks.pop(member_id)
                self._ending.add(task)
                task.add_done_callback(self._ending.discard)
                task.cancel()
        for member_id, member in peers.items():
            if member_id not in self._links:
                link = self._link(member, self._deliver, self._introduce)
                self._links[member_id] = link
                task = asyncio.get_running_loop().create_task(link.run(), name=f"raft-link-{member_id}")
                task.add_done_callback(self._on_end)
                self._tasks[member_id] = task

    def _link(self, member: Member, deliver: Callable[[NetworkEvent], None], introduce: Introduce) -> PeerLink:
        member_id = member.member_id

        def deliver_first(event: NetworkEvent) -> None:
            if isinstance(event, LinkConnected):
                self.outdated.accepted(member_id)
                if self.refusals.accepted(member_id):
                    deliver(StoreDisputed(member_id, ""))
            deliver(event)

        def on_break(why: str) -> None:
            self._on_refused(member_id, why, deliver)

        return PeerLink(member, self._settings, self._dial, deliver_first, on_break, introduce, self._reports)

    def _on_refused(self, member_id: str, why: str, deliver: Callable[[NetworkEvent], None]) -> None:
        if OTHER_CLUSTER in why:
            self.other_cluster = why
        grounds, why = grounds_of(why), _STATUS.sub("", why)
        if grounds is RefusalGrounds.TOO_OLD:
            self._note_refusal(self.outdated, member_id, why, OUTDATED_FOLLOWS)
        elif grounds is not None:
            self.outdated.accepted(member_id)
            if member_id not in self.refusals.words_by_id:
                deliver(StoreDisputed(member_id, why))
            if self._note_refusal(self.refusals, member_id, why, REFUSED_FOLLOWS):
                self.on_refusal_confirmed(self.refusals.why)

    def _note_refusal(self, refusals: Refusals, member_id: str, why: str, what_follows: str) -> bool:
        """Note in `refusals` that a member refuses this member. Returns True if this call has confirmed a refusal.

        `what_follows`: the beginning of a sentence in the warning, such as OUTDATED_FOLLOWS.
        """
        is_new, was_confirmed = member_id not in refusals.words_by_id, refusals.confirmed is not None
        others, leader_id = self.others_and_leader()
        is_confirmed = refusals.refused(member_id, why, others=others, leader_id=leader_id)
        if is_new and not is_confirmed:
            logger.warning(
                "%s refuses this member: %s. %s once the leader or most of the others refuse it, too. If %s is "
                "mistaken, stop %s and start this member again",
                *(member_id, why, what_follows, member_id, member_id),
                extra={"event": "refused_by_member"},
            )
            self._ask_the_others(refusals)
        return is_confirmed and not was_confirmed

    def _ask_the_others(self, refusals: Refusals) -> None:
        """Send a new hello to each member that has not refused this member.

        Only a new hello makes a member accept or refuse this member.
        """
        now = time.monotonic()
        if now - self._others_asked_at > ASK_OTHERS_SECONDS:
            self._others_asked_at = now
            for member_id, link in self._links.items():
                if member_id not in refusals.words_by_id:
                    link.greet_anew()

    def drop(self, member_id: str, why: str) -> None:
        """End the stream of a member that breaks the protocol, and refuse it for a while. Called on the tick thread."""
        self._bridge.post(lambda: self.on_protocol_fault(member_id, why))

    def release(self, messages: Sequence[Outgoing]) -> None:
        """Encode the messages, and queue each on its link. Called on the tick thread."""
        encoded = [(member_id, encode_message(message)) for member_id, message in messages]
        self._bridge.post(lambda: self._enqueue(encoded))

    def has_room(self, member_id: str) -> bool:
        """Whether the link to a member has room for more entries or pieces of a snapshot. Called on the tick thread."""
        link = self._links.get(member_id)
        return link is not None and link.queued_bytes < ROOM_BYTES

    async def close(self) -> None:
        """End every stream.

        Cancels again if a cancellation gets lost in gRPC, because the call ended at the same time.
        """
        self._deliver = None
        tasks = {*self._tasks.values(), *self._ending}
        for _ in range(CANCELLATIONS_MAX):
            for task in tasks:
                task.cancel()
            if tasks:
                _, tasks = await asyncio.wait(tasks, timeout=CANCEL_AGAIN_SECONDS)

    def _enqueue(self, messages: Sequence[tuple[str, pb.RaftMessage]]) -> None:
        for member_id, message in messages:
            link = self._links.get(member_id)
            if link is not None:  # without a link the member has left
                link.enqueue(message)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._on_fatal(error)
