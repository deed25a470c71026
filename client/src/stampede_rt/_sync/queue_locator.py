# Generated from ../_async by tools/generate.py; do not edit.
"""Finds the host of a queue.

The directory names the owner and the addresses of the owner's gatekeeper. The owner also serves the queue at these
addresses.
"""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt._sync.session import CALL_TIMEOUT_S, Session, left_s, request_id
from stampede_rt.cluster.binding import Binding, Owner
from stampede_rt.cluster.tracing import span
from stampede_rt.errors import QueueNotFound, StampedeError, Unavailable
from stampede_rt.v1 import directory_pb2, queue_directory_service_pb2, queue_pb2
from stampede_rt.values.codecs import HandleCodec
from stampede_rt.values.policy import flag_of, parse_name
from stampede_rt.values.queueing import QueueInfo, QueuePolicy
from stampede_rt.wire.queues import queue_info, queue_policy_to_spec


@dataclass(slots=True)
class QueueState:
    """The facts that a handle keeps about its queue or mailbox.

    `kind` and `name` are for texts for people. `info` is the directory's latest description, and `cluster_id` the
    cluster of that directory. `stated` and `create` are the arguments with which the handle opens the queue again.
    """

    kind: str
    name: str
    info: QueueInfo
    stated: QueuePolicy
    create: bool
    coding: HandleCodec | None = None
    cluster_id: str = ""


def queue_state(
    session: Session, name: str, info: QueueInfo, stated: QueuePolicy, create: bool, coding: HandleCodec | None
) -> QueueState:
    """Return the state of a new handle."""
    return QueueState("queue", name, info, stated, create, coding, session.supernodes.cluster_id)


def open_queue(
    session: Session,
    name: str,
    policy: QueuePolicy,
    host: str | None,
    create: bool,
    timeout_s: float = CALL_TIMEOUT_S,
) -> QueueInfo:
    """Get a queue by name, or create it if `create` is True. Returns its description.

    If the lease of the queue's owner has ended, the directory gives the queue another owner.
    """
    request = queue_directory_service_pb2.OpenQueueRequest(
        request_id=request_id(),
        name=name,
        spec=queue_policy_to_spec(policy),
        create=flag_of("create", create),
        host_name=parse_name(host, "host") if host else "",
    )
    with span("open", queue=name):
        response = session.supernodes.call("OpenQueue", request, timeout_s)
    return learn_queue(session, response.queue, response.host)


def learn_queue(session: Session, record: queue_pb2.QueueRecord, host: directory_pb2.HostRecord) -> QueueInfo:
    """Put the owner of a queue, which the directory has named, into the cache. Returns the queue's description."""
    owner = Owner(
        host_id=record.host_id, epoch=record.epoch, spec_version=record.spec_version, incarnation=record.incarnation
    )
    session.cache.learn_owner(record.queue_id, owner, [endpoint.target for endpoint in host.gatekeepers])
    return queue_info(record, host)


class QueueLocator:
    """Finds the binding of a queue."""

    def __init__(self, session: Session, state: QueueState) -> None:
        self._session = session
        self._state = state
        self._turn = 0  # counts failures; after each failure the client uses the next address of the host

    def find(self, deadline_s: float) -> Binding:
        """Return the queue's binding, from the cache or from the cluster."""
        queue_id = self._state.info.queue_id
        owner = self._session.cache.reachable_owner(queue_id)
        if owner is None:
            self._resolve(deadline_s)
            owner = self._session.cache.owner(queue_id)
        targets = self._session.cache.gatekeepers(owner.host_id) if owner is not None else ()
        if owner is None or not targets:
            raise Unavailable(f"the {self._state.kind} {self._state.name!r} has no owner at present; try again soon")
        return Binding(
            subject_id=queue_id,
            target=targets[self._turn % len(targets)],
            epoch=owner.epoch,
            incarnation=owner.incarnation,
        )

    def _resolve(self, deadline_s: float) -> None:
        """Ask a supernode for the owner. If the owner is lost, open the queue again without a policy.

        Raises Unavailable if the handle's arguments have `create` False.
        """
        state = self._state
        request = queue_directory_service_pb2.ResolveQueueRequest(queue_id=state.info.queue_id)
        try:
            response = self._session.supernodes.call("ResolveQueue", request, left_s(deadline_s))
        except QueueNotFound as error:
            self._resolve_name(error, deadline_s)
            return
        if response.host.alive:
            state.info = learn_queue(self._session, response.queue, response.host)
        else:
            self._replace_owner(response.host.name, deadline_s)

    def _replace_owner(self, lost_host: str, deadline_s: float) -> None:
        state = self._state
        if not state.create:
            raise Unavailable(
                f"the host of queue {state.name!r} ({lost_host or 'unknown'}) is lost with its messages; start the "
                "host again, or open the queue with create=True to have it at another host",
                reason="NO_HOST",
            )
        state.info = open_queue(self._session, state.name, QueuePolicy(), None, False, left_s(deadline_s))

    def _resolve_name(self, error: QueueNotFound, deadline_s: float) -> None:
        """Open the queue by its name, because the directory does not know its id any more.

        Creates the queue only if the directory itself began anew, for example after the restart of a directory that is
        kept in memory only. Raises QueueNotFound.
        """
        state, supernodes = self._state, self._session.supernodes
        create = state.create and supernodes.present_cluster(deadline_s) != state.cluster_id
        state.info = open_queue(self._session, state.name, state.stated, None, create, left_s(deadline_s))
        state.cluster_id = supernodes.cluster_id

    def is_stale(self, error: StampedeError) -> bool:
        """Whether a service does not know the queue that the cache names. Another queue may have the same name."""
        return isinstance(error, QueueNotFound) and self._session.cache.owner(self._state.info.queue_id) is not None

    def forget(self, error: StampedeError | None = None) -> None:
        """Forget the binding."""
        self._turn += 1
        self._session.cache.forget(self._state.info.queue_id)

    def check(self) -> None:
        """Raise ForkedProcess, WrongEventLoop, or Unavailable if the connection is closed."""
        self._session.check()

    def explain(self, error: StampedeError) -> None:
        """Add the name of the queue to the error."""
        error.concerning(self._state.kind, self._state.name)

    @property
    def closed(self) -> bool:
        """Whether the connection is closed."""
        return self._session.closed
