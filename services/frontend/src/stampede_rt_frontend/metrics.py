"""The metrics of a front-end, without the metrics that every service has."""

from __future__ import annotations

from stampede_rt_frontend.probe import Prober
from stampede_rt_frontend.roster import SupernodeRoster
from stampede_rt_frontend.servicer import FrontendServicer
from stampede_rt_runtime.metrics.families import AnyFamily, Metric, counter, gauge
from stampede_rt_runtime.metrics.service_metrics import of_clocks

BINDS = counter("stampede_frontend_binds_total", "Calls of clients and hosts that asked for the supernodes.")
BINDS_WAITING = gauge(
    "stampede_frontend_binds_waiting", "Calls that asked for the supernodes and wait until one can serve."
)
SERVING = gauge(
    "stampede_frontend_supernode_serving", "1 if the supernode at this address can serve, else 0.", "supernode"
)
ROUND_TRIP = gauge(
    "stampede_frontend_round_trip_seconds", "The smoothed round trip to the supernode at this address.", "supernode"
)

METRICS: tuple[Metric, ...] = tuple(one for one in [*globals().values()] if isinstance(one, Metric))


class FrontendMetrics:
    """The metrics of one front-end. Their number is bounded by the number of supernodes."""

    def __init__(self, roster: SupernodeRoster, prober: Prober, servicer: FrontendServicer) -> None:
        self._roster = roster
        self._prober = prober
        self._servicer = servicer

    async def collect(self) -> list[AnyFamily]:
        """All metrics."""
        states, trips = self._roster.states(), self._roster.round_trips()
        return [
            BINDS.of(self._servicer.binds),
            BINDS_WAITING.of(self._prober.waiting),
            SERVING.family(((target,), why is None) for target, why in states.items()),
            ROUND_TRIP.family(((target,), nanos / 1e9) for target, nanos in trips.items()),
            *of_clocks(self._roster.clocks),
        ]
