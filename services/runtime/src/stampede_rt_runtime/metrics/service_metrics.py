"""The metrics that every service has: its calls, its refusals, its event loop and its clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from stampede_rt.values.peering import ClockOffset
from stampede_rt_runtime.metrics.families import AnyFamily, Family, Metric, counter, gauge, histogram
from stampede_rt_runtime.metrics.loop_lag import LoopLag
from stampede_rt_runtime.server import ServiceServer
from stampede_rt_runtime.version import software_version

BUILD_INFO = gauge("stampede_build_info", "The service and its version; the value is always 1.", "service", "version")
READY = gauge("stampede_ready", "1 if the service can serve its callers now, else 0; the health service says the same.")
STREAMS_OPEN = gauge(
    "stampede_streams_open", "Streams that are open now, by the transport that carries them.", "transport"
)
CALLS_OPEN = gauge("stampede_calls_open", "Calls other than streams that are under way now.")
MEMBER_CALLS_OPEN = gauge(
    "stampede_member_calls_open",
    "Calls that only services of the cluster and operators may make, such as Raft and leases, that are under way now.",
)
CALLS_REFUSED = counter("stampede_calls_refused_total", "Calls that the service refused because a limit was reached.")
CALLS_DENIED = counter("stampede_calls_denied_total", "Calls of callers that had no valid credential, role or right.")
QUOTA_REFUSALS = counter(
    "stampede_quota_refusals_total", "Requests that were refused because the caller's quota was used up.", "quota"
)
EVENT_LOOP_LAG = histogram(
    "stampede_event_loop_lag_seconds", "How late the event loop performed a call that was due, ten samples each second."
)
CLOCK_OFFSET = gauge(
    "stampede_clock_offset_seconds", "This service's clock minus the clock of the named supernode.", "peer"
)
CLOCK_UNCERTAINTY = gauge(
    "stampede_clock_uncertainty_seconds", "The most by which the measured clock offset may be wrong.", "peer"
)
CERTIFICATE_EXPIRY = gauge(
    "stampede_certificate_expiry_timestamp_seconds", "When the service's own certificate ends, as a Unix time."
)

METRICS: tuple[Metric, ...] = (
    BUILD_INFO, READY, STREAMS_OPEN, CALLS_OPEN, MEMBER_CALLS_OPEN, CALLS_REFUSED, CALLS_DENIED, QUOTA_REFUSALS,
    EVENT_LOOP_LAG, CLOCK_OFFSET, CLOCK_UNCERTAINTY, CERTIFICATE_EXPIRY,
)  # fmt: skip


def of_server(server: ServiceServer, service: str, lag: LoopLag) -> list[AnyFamily]:
    """The metrics of one server."""
    slots, sockets, accounts = server.slots, server.sockets.streams_open, server.access.accounts
    families: list[AnyFamily] = [
        BUILD_INFO.of(1, service, software_version()),
        READY.of(server.is_serving),
        STREAMS_OPEN.family([(("grpc",), max(0, slots.streams - sockets)), (("socket",), sockets)]),
        CALLS_OPEN.of(slots.singles),
        MEMBER_CALLS_OPEN.of(slots.reserved),
        CALLS_REFUSED.of(server.refused_calls.count),
        CALLS_DENIED.of(server.access.audit.denials),
        QUOTA_REFUSALS.family([((str(quota),), count) for quota, count in accounts.refusals_of.items()]),
        lag.lags.family(EVENT_LOOP_LAG),
    ]
    ends_s = server.certificate_ends_unix_s()
    return families if ends_s is None else [*families, CERTIFICATE_EXPIRY.of(ends_s)]


def of_clocks(clocks: Mapping[str, ClockOffset]) -> Iterable[Family]:
    """The comparisons of this service's clock with the clocks of supernodes, by supernode."""
    yield CLOCK_OFFSET.family([((peer,), one.offset_nanos / 1e9) for peer, one in clocks.items()])
    yield CLOCK_UNCERTAINTY.family([((peer,), one.uncertainty_nanos / 1e9) for peer, one in clocks.items()])
