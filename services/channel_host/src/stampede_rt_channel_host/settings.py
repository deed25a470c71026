"""The settings of `stampede host`."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt.cluster.addresses import ADDRESSES_MAX
from stampede_rt.values.policy import NAME_GRAMMAR
from stampede_rt_runtime.main import ServiceSettings
from stampede_rt_runtime.settings import setting
from stampede_rt_runtime.values import parse_address_text, parse_list, parse_size, parse_target

MEMORY_BYTES_MIN = 2**20


@dataclass(frozen=True, kw_only=True)
class HostSettings(ServiceSettings):
    """Holds channels and queues and serves them. Run one on each machine, or several."""

    listen: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_address_text,
            help="the address at which the host listens (port 0: any free port); default: localhost, or, if a "
            "front-end is on another machine, this machine's address towards that front-end, and any free port",
        ),
    )
    advertise: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_target,
            help="the address at which others reach the host; default: --listen",
        ),
    )
    name: str = field(
        default="",
        metadata=setting(
            metavar="NAME", help="the host's name in the directory; default: the machine's name with a random end"
        ),
    )
    frontend: tuple[str, ...] = field(
        default=("localhost:7580",),
        metadata=setting(metavar="HOST:PORT,...", parse=parse_list(parse_target), help="front-ends of the cluster"),
    )
    zone: str = field(
        default="",
        metadata=setting(metavar="ZONE", help="the network or site of this host; it prefers supernodes of its zone"),
    )
    data_dir: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FOLDER",
            help="the folder that keeps the host's identity over restarts; default: none, each start makes a new host",
        ),
    )
    memory_bytes_max: int = field(
        default=4 * 2**30,
        metadata=setting(
            metavar="SIZE",
            parse=parse_size,
            minimum=MEMORY_BYTES_MIN,
            help="the most memory that all channels and queues may use together; beyond it the host refuses puts",
        ),
    )

    def __post_init__(self) -> None:
        if not 0 < len(self.frontend) <= ADDRESSES_MAX:
            raise ValueError(f"--frontend names {len(self.frontend)} front-ends; allowed: 1 to {ADDRESSES_MAX}")
        if self.name and not re.fullmatch(NAME_GRAMMAR, self.name):
            raise ValueError(f"--name is {self.name!r}; allowed: {NAME_GRAMMAR}")
