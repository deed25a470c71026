"""A peer's registration: its lease, which the client renews in the background, and its mailbox (paper, section 4.2)."""

from __future__ import annotations

import logging
import os
import random
import time
from collections.abc import Callable

from stampede_rt._async.listener import should_log
from stampede_rt._async.queue import TakingHandle
from stampede_rt._async.queue_locator import QueueLocator, QueueState, learn_queue
from stampede_rt._async.session import Session, request_id
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.registration_epoch import RegistrationEpoch
from stampede_rt.errors import (
    DeadlineExceeded,
    LeaseExpired,
    PeerExists,
    QueueNotFound,
    StaleRegistration,
    StampedeError,
    Unavailable,
)
from stampede_rt.handles import BoundToProcess
from stampede_rt.transports.concurrency_async import BackgroundTask, Signal, sleep
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.values.peering import ClockOffset, PeerIdentity, PeerInfo
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt.version import VERSION
from stampede_rt.wire.peers import clock_message, peer_info

LEAVE_TIMEOUT_S = 1.0  # for each of two steps: the end of the renewals, and the call that deregisters the peer
NAME_RETRY_S = 0.25
RENEWALS_IN_LEASE = 3
_log = logging.getLogger("stampede_rt")


class Presence:
    """Keeps one peer registered: renews its lease, and registers again if the lease ended or the mailbox is lost.

    `error` says why the peer cannot be registered any more, for example because another process has the name. It is
    None before that. Once it is set, the peer does not register again.
    """

    def __init__(self, session: Session, name: str, proof: str | None) -> None:
        self._session = session
        self._identity = PeerIdentity.parse(name, proof, os.urandom(48))
        self._boot_incarnation = int.from_bytes(os.urandom(8), "little") | 1  # a new one at each start
        self._epoch = RegistrationEpoch()
        self._name = name
        self._lease_s = 0.0
        self._wake = Signal()
        self._has_left = False
        self._registered = False
        self._failures = 0  # failed renewals and registrations since the last success
        self._background: BackgroundTask | None = None
        self.peer: PeerInfo | None = None
        self._mailbox: QueueState | None = None
        self.error: StampedeError | None = None
        self.on_lost: Callable[[StampedeError], None] | None = None  # called once, when `error` is set

    @property
    def peer_id(self) -> bytes:
        """The id of this peer."""
        return self._identity.peer_id

    async def begin(self, timeout_s: float, *, waits_for_name: bool = False) -> QueueState:
        """Register, begin to renew the lease, and return the mailbox. Raises PeerExists, Unavailable.

        `waits_for_name`: while another live peer has the name, try again until the time is over. That peer may be the
        former process of this program, whose lease ends by itself.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:  # paced by the sleep; ends at the deadline
            try:
                mailbox = await self._register(deadline_s - time.monotonic())
                break
            except PeerExists:
                if not waits_for_name or time.monotonic() + NAME_RETRY_S >= deadline_s:
                    raise
            await sleep(NAME_RETRY_S)
        self._session.attach(self)
        self._background = BackgroundTask(self._keep, f"lease of peer {self._name}")
        return mailbox

    async def _register(self, timeout_s: float) -> QueueState:
        """Register with a higher registration epoch than any other process of this peer.

        Raises PeerExists, Unavailable.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:  # repeats if another process has registered meanwhile; ends at the deadline
            try:
                return await self._register_once(deadline_s - time.monotonic())
            except StaleRegistration as error:
                if not self._epoch.may_overtake(error):
                    raise self._taken_over() from error
                if time.monotonic() >= deadline_s:
                    raise Unavailable(str(error)) from error

    async def _register_once(self, timeout_s: float) -> QueueState:
        request = peer_pb.RegisterPeerRequest(
            request_id=request_id(),
            peer_id=self.peer_id,
            name=self._name,
            boot_incarnation=self._boot_incarnation,
            proof=self._identity.proof,
            zone=self._session.zone,
            version=VERSION,
            clock=clock_message(self._session.supernodes.clock),
            registration_epoch=self._epoch.value,
        )
        try:
            response = await self._session.supernodes.call("RegisterPeer", request, timeout_s)
        except PeerExists as error:
            raise PeerExists(
                f"another live peer has the name {self._name!r}; take another name, or wait until that peer leaves or "
                "its lease ends. A restarted program gets its name back immediately if it gives the same `proof` "
                "both times",
                metadata=error.metadata,
            ) from error
        return self._learn(response)

    def _learn(self, response: peer_pb.RegisterPeerResponse) -> QueueState:
        self._epoch.note_registered()
        self._lease_s = response.lease_ttl_nanos / 1e9
        info = learn_queue(self._session, response.mailbox, response.mailbox_host)
        if self._mailbox is None:
            self._mailbox = QueueState("mailbox of peer", self._name, info, QueuePolicy(), create=False)
        self._mailbox.info = info
        self.peer = peer_info(response.peer)
        self._registered = True
        return self._mailbox

    def check(self) -> None:
        """Raise `error` if it is set, and Unavailable (retryable) while the peer registers again."""
        if self.error is not None:
            raise self.error
        if not self._registered:
            raise Unavailable(
                f"the mailbox of peer {self._name!r} was lost with its host, and the peer is registering again; "
                "try again soon"
            )

    def register_again(self) -> None:
        """Make the background task register again, because the mailbox is lost.

        The directory then gives the peer another mailbox.
        """
        self._registered = False
        self._wake.set()

    async def _keep(self) -> None:
        while not self._has_left and self.error is None:
            await self._wake.wait(self._lease_s / RENEWALS_IN_LEASE * (0.75 + random.random() / 4))
            self._wake.clear()
            if not self._has_left:
                await self._renew_or_register()

    async def _renew_or_register(self) -> None:
        timeout_s = self._lease_s / RENEWALS_IN_LEASE
        try:
            if self._registered:
                await self._renew(timeout_s)
                self._failures = 0
        except LeaseExpired as error:
            if self._epoch.is_overtaken(error):
                self._lose(self._taken_over())
                return
            _log.warning("the lease of peer %r has ended; the peer registers again", self._name)
            self._registered = False
        except StampedeError as error:
            self._log_failure("the lease of peer %r was not renewed", error)
        if self._registered:
            return
        try:
            await self._register(timeout_s)
            self._failures = 0
        except (Unavailable, DeadlineExceeded) as error:
            self._log_failure("peer %r could not register again", error)
        except StampedeError as error:
            self._lose(error)

    def _lose(self, error: StampedeError) -> None:
        self.error = error
        _log.error("the peer %r is no longer registered: %s", self._name, error)
        if self.on_lost is not None:
            self.on_lost(error)

    def _taken_over(self) -> PeerExists:
        return PeerExists(
            f"another process took over the name {self._name!r} with the same proof, as if it were a restart of this "
            "process; give each process a proof of its own if both should run",
            metadata={"peer": self._name},
        )

    def _log_failure(self, event: str, error: StampedeError) -> None:
        """Log the 1st, 2nd, 4th, 8th ... failure in a row. `event` has a place for the peer's name."""
        self._failures += 1
        if should_log(self._failures):
            _log.warning(f"{event}; the client tries again: %s", self._name, error)

    async def _renew(self, timeout_s: float) -> None:
        """Renew the lease at the leader, because only the leader renews leases.

        The call also measures this machine's clock against the leader's clock.
        """
        supernodes = self._session.supernodes
        request = peer_pb.RenewPeerLeaseRequest(
            peer_id=self.peer_id,
            boot_incarnation=self._boot_incarnation,
            clock=clock_message(supernodes.clock),
        )
        began, sent = time.monotonic_ns(), time.time_ns()  # the monotonic clock first, see DirectoryClient._ping
        response = await supernodes.call_leader("RenewPeerLease", request, timeout_s)
        took = time.monotonic_ns() - began
        if response.supernode_id:  # a supernode of an older release does not send its time
            supernodes.clock = ClockOffset.measured(
                sent_unix_nano=sent,
                took_nanos=took,
                told_unix_nano=response.time_unix_nano,
                supernode=response.supernode_id,
                held_nanos=response.held_nanos,
            )

    async def end(self) -> None:
        """Deregister the peer, so that the directory frees its name and deletes its mailbox.

        If the call fails, only logs the error. The directory then does both when the lease ends.
        """
        self._has_left = True
        self._wake.set()
        if self._background is not None:
            await self._background.join(LEAVE_TIMEOUT_S)
        self._session.detach(self)
        if self.error is not None:
            return
        request = peer_pb.DeregisterPeerRequest(
            request_id=request_id(), peer_id=self.peer_id, boot_incarnation=self._boot_incarnation
        )
        try:
            await self._session.supernodes.call("DeregisterPeer", request, LEAVE_TIMEOUT_S)
        except StampedeError as error:
            if isinstance(error, LeaseExpired) and self._epoch.is_overtaken(error):
                return  # another process has the name
            _log.warning("the peer %r could not deregister; its lease ends by itself: %s", self._name, error)


class MailboxLocator(QueueLocator):
    """Finds the connection's own mailbox. If the mailbox is lost, the peer registers again and gets a new mailbox."""

    def __init__(self, session: Session, presence: Presence, state: QueueState) -> None:
        super().__init__(session, state)
        self._presence = presence

    async def find(self, deadline_s: float) -> Binding:
        """Return the mailbox's binding, from the cache or from the cluster. Raises the error of `Presence.check`."""
        self._presence.check()
        return await super().find(deadline_s)

    async def _resolve_name(self, error: QueueNotFound, deadline_s: float) -> None:
        raise error  # a mailbox has no name; `explain` makes the peer register again

    async def _replace_owner(self, lost_host: str, deadline_s: float) -> None:
        self._presence.register_again()
        self._presence.check()

    def explain(self, error: StampedeError) -> None:
        """Add the name of the mailbox to the error.

        If the mailbox does not exist, make the peer register again, and mark the error as retryable.
        """
        super().explain(error)
        if isinstance(error, QueueNotFound):
            self._presence.register_again()
            error.retryable = True


class Mailbox(TakingHandle, BoundToProcess):
    """The queue of the messages that others send to this connection's peer (see `Connection.send`).

    It exists as long as the peer is registered. `get`, loops, `stats`, `pending` and `aclose` work as with a `Queue`.
    """

    def __init__(self, session: Session, presence: Presence, state: QueueState) -> None:
        super().__init__(session, state, MailboxLocator(session, presence, state), 1)
        presence.on_lost = self._taker.interrupt
