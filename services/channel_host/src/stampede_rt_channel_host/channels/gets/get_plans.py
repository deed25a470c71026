"""Decodes the requests of one stream of gets, and keeps the decoded requests.

A reader often repeats a request, for example for the newest item of one channel. Only the call id differs then, so the
host need not decode the rest again.
"""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.copy_state import Freshness
from stampede_rt_channel_host.channels.group_access import GroupReadParams
from stampede_rt_channel_host.channels.requests import demand_of, group_of, parse, query_of, wait_nanos_of
from stampede_rt_channel_host.core.channel import Query

PLANS_MAX = 64
REQUEST_BYTES_MAX = 4096  # limits the memory for plans, whose keys are bytes of requests; valid requests have < 512
_CALL_ID_TAG = 1 << 3  # GetRequest.call_id, varint
_VARINT_BYTES_MAX = 10


@dataclass(frozen=True, kw_only=True, slots=True)
class GetPlan:
    """The decoded fields of a get, without its call id.

    `wait_nanos`: 0 means that the get may not wait; below 0 means that it may wait without limit. `group`: the group
    through which the get reads, if any. `demand`: the read's demands on a copy; None: it accepts none.
    `as_of`: answer as at this instant.
    """

    channel_id: bytes
    epoch: int
    query: Query
    wait_nanos: int
    without_payloads: bool
    demand: Freshness | None = None
    group: GroupReadParams | None = None
    within_memory: bool = False
    as_of: int | None = None


@dataclass(frozen=True, slots=True)
class GetCall:
    """One request on the stream.

    `plan`: the get to perform. `refusal`: the error of an invalid get. Both are None for a request that cancels a get.
    """

    call_id: int
    plan: GetPlan | None
    refusal: StampedeError | None = None


def check_length(raw: bytes) -> None:
    """Raises InvalidArgument for a request of more than REQUEST_BYTES_MAX."""
    if len(raw) > REQUEST_BYTES_MAX:
        raise InvalidArgument(f"the get request has {len(raw)} bytes; it has at most {REQUEST_BYTES_MAX}")


class GetPlans:
    """The plans of one stream, at most PLANS_MAX. If a further plan comes, all kept plans are dropped first."""

    def __init__(self) -> None:
        self._plans: dict[bytes, GetPlan] = {}

    def read(self, raw: bytes) -> GetCall:
        """Decode one request, whose length was checked. Raises InvalidArgument if the bytes are no request."""
        call_id, rest = _split(raw)
        plan = self._plans.get(rest)
        return GetCall(call_id, plan) if plan is not None else self._read_new(raw, rest)

    def _read_new(self, raw: bytes, rest: bytes) -> GetCall:
        request: pb.GetRequest = parse(pb.GetRequest, raw, "GetRequest")
        if request.cancel:
            return GetCall(request.call_id, None)
        try:
            plan = _plan(request)
        except StampedeError as error:
            return GetCall(request.call_id, None, error)
        if len(self._plans) >= PLANS_MAX:
            self._plans.clear()
        # `rest` has a call id if that field was not the first, or came twice. Such a plan would fit only this call.
        if not pb.GetRequest.FromString(rest).call_id:
            self._plans[rest] = plan
        return GetCall(request.call_id, plan)


def _plan(request: pb.GetRequest) -> GetPlan:
    if request.HasField("as_of_unix_nano") and request.HasField("group_id") and not request.HasField("cut_unix_nano"):
        raise InvalidArgument("as_of: a read through a group needs the cut of that instant; set cut_unix_nano")
    return GetPlan(
        channel_id=request.channel_id,
        epoch=request.epoch,
        query=query_of(request),
        wait_nanos=wait_nanos_of(request),
        without_payloads=request.without_payloads,
        demand=demand_of(request),
        group=group_of(request),
        within_memory=request.within_memory,
        as_of=request.as_of_unix_nano if request.HasField("as_of_unix_nano") else None,
    )


def _split(raw: bytes) -> tuple[int, bytes]:
    """The call id and the bytes after it, if the call id is the first field, as usual; otherwise 0 and all bytes."""
    if not raw or raw[0] != _CALL_ID_TAG:
        return 0, raw
    call_id = 0
    for offset in range(1, min(len(raw), _VARINT_BYTES_MAX + 1)):
        call_id |= (raw[offset] & 0x7F) << 7 * (offset - 1)
        if raw[offset] < 0x80:
            return call_id & 2**64 - 1, raw[offset + 1 :]
    return 0, raw
