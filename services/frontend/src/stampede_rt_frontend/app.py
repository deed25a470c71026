"""The front-end as a process: `stampede frontend`."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from stampede_rt.v1 import frontend_service_pb2_grpc
from stampede_rt_frontend.metrics import FrontendMetrics
from stampede_rt_frontend.probe import Prober
from stampede_rt_frontend.roster import SupernodeRoster
from stampede_rt_frontend.servicer import FrontendServicer
from stampede_rt_frontend.settings import FrontendSettings
from stampede_rt_runtime.clock import SystemClock
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.limits import CONTROL_LIMITS
from stampede_rt_runtime.main import announce, run_service
from stampede_rt_runtime.metrics.serving import serving_metrics
from stampede_rt_runtime.server import ServiceServer


async def serve(settings: FrontendSettings) -> None:
    """Serve until a stop signal. Raises CannotListen or PermissionDenied."""
    credentials = settings.load_credentials(Role.FRONTEND)
    server = ServiceServer(
        secret=credentials.secret,
        client_secret=credentials.client_secret,
        tls=credentials.tls,
        limits=CONTROL_LIMITS,
        reflection=settings.reflection,
    )
    roster = SupernodeRoster(tuple(dict.fromkeys(settings.supernodes)))
    async with Prober(roster, credentials, explain=credentials.explain, access=server.access) as prober:
        servicer = FrontendServicer(roster, prober, SystemClock(), server.access, default_zone=settings.zone)
        frontend_service_pb2_grpc.add_FrontendServiceServicer_to_server(servicer, server.grpc)
        address = server.bind(settings.listen, allow_insecure_anywhere=settings.allow_insecure_anywhere)
        metrics = FrontendMetrics(roster, prober, servicer)
        async with serving_metrics(settings.metrics_address(), "frontend", server, metrics.collect):
            await server.start()
            await server.set_serving(True)
            # Printed when `run` handles stop signals, because a process that waits for this line may then send one.
            asyncio.get_running_loop().call_soon(announce, f"stampede frontend ready on {address}")
            await server.run()


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede frontend`; returns the exit code."""
    return run_service(FrontendSettings, "frontend", argv, serve)
