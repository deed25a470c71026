"""What `stampede host` can be told."""

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
    """Stores channels and serves their items. Run one on each machine, or several."""

    listen: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_address_text,
            help="where it listens, port 0: any free one; left out: localhost, or, with the front-end on another "
            "machine, the address that leads there",
        ),
    )
    advertise: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT", parse=parse_target, help="where others reach it, if that is not where it listens"
        ),
    )
    name: str = field(
        default="",
        metadata=setting(metavar="NAME", help="its name in the directory; without it: the machine's and a random end"),
    )
    frontend: tuple[str, ...] = field(
        default=("localhost:7580",),
        metadata=setting(
            metavar="HOST:PORT,...", parse=parse_list(parse_target), help="front-ends, which lead to the directory"
        ),
    )
    zone: str = field(
        default="", metadata=setting(metavar="ZONE", help="the network or site it is in; its callers prefer it")
    )
    data_dir: Path | None = field(
        default=None,
        metadata=setting(metavar="FOLDER", help="keeps its identity over restarts; without it, it enters as a new one"),
    )
    memory_bytes_max: int = field(
        default=4 * 2**30,
        metadata=setting(
            metavar="SIZE",
            parse=parse_size,
            minimum=MEMORY_BYTES_MIN,
            help="items of all channels together; puts beyond it are refused until some go",
        ),
    )

    def __post_init__(self) -> None:
        if not 0 < len(self.frontend) <= ADDRESSES_MAX:
            raise ValueError(f"--frontend names {len(self.frontend)} front-ends; allowed: 1 to {ADDRESSES_MAX}")
        if self.name and not re.fullmatch(NAME_GRAMMAR, self.name):
            raise ValueError(f"--name is {self.name!r}; allowed: {NAME_GRAMMAR}")
