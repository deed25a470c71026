# Generated from ../_async by tools/generate.py; do not edit.
"""Finds copies of channels for reads: the host of a channel says which copy to use (paper, section 4.1: proxies)."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.session import Session
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import DeadlineExceeded, StaleBinding, StampedeError
from stampede_rt.transports.concurrency_sync import monotonic_s
from stampede_rt.transports.machine import this_machine
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import gatekeeper_service_pb2

BIND_TIMEOUT_S = 6.0  # a host makes the caller wait 5 s for a new copy
GET_TIMEOUT_S = 1.0  # for one request, while the client looks for a copy for a get
FOUND_S = 10.0  # after this time the client asks the owner again, so that its gets use all copies in turn
REFUSED_S = 0.25  # for this time gets go to the owner, after a copy was too old
# For this time gets go to the owner, after a copy could not be reached, or the owner has named no copy.
LOST_S = 2.0


def copy_for_gets(session: Session, state: ChannelState) -> Binding | None:
    """Return a copy of the channel; None if there is none to use at this moment.

    Blocks for three times GET_TIMEOUT_S at most. Raises the errors that the owner would raise, too.
    """
    is_known, binding = session.copies.find(state.info.channel_id, monotonic_s())
    if is_known:
        return binding
    try:
        owner = session.bind(state, monotonic_s() + GET_TIMEOUT_S)
        target = _copy_of(session, state, owner)
        binding = bound_at(session, state, target, owner.epoch, GET_TIMEOUT_S) if target else None
    except StampedeError as error:
        if not may_succeed_at_owner(error):
            raise
        binding = None
    session.copies.keep(state.info.channel_id, binding, monotonic_s() + (LOST_S if binding is None else FOUND_S))
    return binding


def note_refusal(session: Session, state: ChannelState, error: StampedeError) -> None:
    """Note that the copy did not serve a get, so that the next gets go to the owner for a moment."""
    rest_s = REFUSED_S if isinstance(error, StaleBinding) else LOST_S
    session.copies.keep(state.info.channel_id, None, monotonic_s() + rest_s)


def may_succeed_at_owner(error: StampedeError) -> bool:
    """Whether the owner may serve a request to which a copy has answered `error`."""
    return error.retryable or isinstance(error, DeadlineExceeded)


def copy_target_of(error: StampedeError) -> str:
    """Return the gatekeeper of the copy to which a host sends a reader; empty if the host names no copy."""
    return error.metadata.get("copy_target", "") if isinstance(error, StaleBinding) else ""


def bound_at(
    session: Session, state: ChannelState, target: str, epoch: int, timeout_s: float = BIND_TIMEOUT_S
) -> Binding:
    """Bind the channel at the gatekeeper `target` of a copy's host.

    Blocks for `timeout_s` at most. Raises StaleBinding if that host cannot serve readers, Unavailable,
    DeadlineExceeded.
    """
    endpoint = session.endpoints.to(target)
    request = gatekeeper_service_pb2.BindChannelRequest(
        channel_id=state.info.channel_id, epoch=epoch, machine=this_machine()
    )
    response = endpoint.call(endpoint.gatekeeper.BindChannel, request, timeout_s)
    record = response.channel
    targets = [e.target for e in response.endpoints if e.transport == gatekeeper_service_pb2.TRANSPORT_GRPC]
    binding = Binding(
        subject_id=record.channel_id,
        target=targets[0] if targets else target,
        epoch=record.epoch,
        incarnation=record.incarnation,
    )
    session.endpoints.to(binding.target).route.learn(response.endpoints)
    return binding


def _copy_of(session: Session, state: ChannelState, owner: Binding) -> str:
    """Return the gatekeeper of a copy, as the owner names it; empty if there is none."""
    endpoint = session.endpoints.to(owner.target)
    request = gatekeeper_service_pb2.BindChannelRequest(
        channel_id=state.info.channel_id, epoch=owner.epoch, machine=this_machine(), wants_copy=True
    )
    response = endpoint.call(endpoint.gatekeeper.BindChannel, request, GET_TIMEOUT_S)
    return str(response.copy_target)


def open_at_owner_or_copy(
    session: Session,
    state: ChannelState,
    owner: Binding,
    target: str,
    opening: channel_pb.SubscribeOpen,
    open_stream: Callable[[Binding], None],
) -> None:
    """Open a subscription at the owner, or at the copy to which the owner sends the reader.

    `target`: the gatekeeper of the copy, if the owner has named it before. If the copy cannot serve the reader, the
    reader stays at the owner (`opening.stay`).
    """
    if not target:
        try:
            open_stream(owner)
            return
        except StaleBinding as error:
            target = copy_target_of(error)
            if not target:
                raise
    try:
        open_stream(bound_at(session, state, target, owner.epoch))
    except StampedeError as error:
        if not may_succeed_at_owner(error):
            raise
        opening.stay = True
        try:
            open_stream(owner)
        finally:
            opening.stay = False
