"""The settings of `stampede frontend`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_frontend.roster import SUPERNODES_MAX
from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import setting
from stampede_rt_runtime.values import parse_address_text, parse_list, parse_target


@dataclass(frozen=True, kw_only=True)
class FrontendSettings(ServiceSettings):
    """Tells callers the addresses of the supernodes. It keeps no state: run as many as you like."""

    listen: str = field(
        default="localhost:7580",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_address_text,
            help="the address at which the front-end listens (port 0: any free port)",
        ),
    )
    supernodes: tuple[str, ...] = field(
        metadata=setting(
            metavar="HOST:PORT,...",
            parse=parse_list(parse_target),
            help="the supernodes that the front-end asks first; they name the other supernodes",
            example="localhost:7590",
        ),
    )
    zone: str = field(
        default="",
        metadata=setting(metavar="ZONE", help="the zone of callers that name no zone"),
    )

    def __post_init__(self) -> None:
        if not 0 < len(self.supernodes) <= SUPERNODES_MAX:
            raise ValueError(f"--supernodes names {len(self.supernodes)} supernodes; allowed: 1 to {SUPERNODES_MAX}")
