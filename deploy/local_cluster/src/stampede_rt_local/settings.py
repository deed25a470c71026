"""The settings of `stampede dev`."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from stampede_rt_runtime.archive_places import check_archive, default_folder, parse_archive
from stampede_rt_runtime.logs import FORMATS, LEVELS
from stampede_rt_runtime.settings import setting
from stampede_rt_runtime.values import parse_address, parse_address_text

DEFAULT_ADDRESS = "localhost:7580"
PAGE_MODULE = "stampede_rt_web"
_WILDCARDS = frozenset({"0.0.0.0", "::"})


@dataclass(frozen=True, kw_only=True)
class DevSettings:
    """Runs the whole system on this machine, in memory. Ctrl-C stops it, and its items are lost.

    With --archive the items of recorded channels stay, and the names of all channels, groups and queues. The next start
    with the same --archive, --hosts and --supernodes has them again. If one of several hosts or a minority of the
    supernodes ends, the others go on. The items of that host are lost.
    """

    listen: str = field(
        default=DEFAULT_ADDRESS,
        metadata=setting(
            metavar="HOST:PORT", parse=parse_address_text, help="the front-end's address; port 0: any free one"
        ),
    )
    hosts: int = field(
        default=1, metadata=setting(metavar="N", minimum=1, maximum=16, help="the number of channel hosts")
    )
    supernodes: int = field(
        default=1, metadata=setting(metavar="N", minimum=1, maximum=7, help="the number of supernodes")
    )
    web: bool = field(default=False, metadata=setting(shared=False, help="serve the page of `stampede web`, too"))
    web_listen: str = field(
        default="localhost:7581",
        metadata=setting(
            metavar="HOST:PORT", parse=parse_address_text, help="the page's address; port 0: any free one"
        ),
    )
    secret_file: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FILE", help="the file of the shared secret, made if absent; default: the user's own file"
        ),
    )
    allow_insecure_anywhere: bool = field(
        default=False,
        metadata=setting(
            help="listen beyond this machine without encryption, although the whole network can read the items"
        ),
    )
    reflection: bool = field(
        default=False,
        metadata=setting(help="describe the services of each port to callers with a credential, as for grpcurl"),
    )
    archive: Path | str | None = field(
        default=None,
        metadata=setting(
            metavar="PLACE",
            parse=parse_archive,
            help="the folder in which recorded channels and all names stay over restarts, or an object store: "
            "s3://BUCKET/PREFIX, gs://, az:// or file:// (extra [objects])",
        ),
    )
    archive_folder: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FOLDER",
            help="with a URL in --archive: the folder of files that have not moved to the object store; default: "
            "~/.local/state/stampede/archive",
        ),
    )
    log_format: str = field(
        default="text",
        metadata=setting(metavar="FORMAT", choices=FORMATS, help="the form of the log"),
    )
    metrics: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_address_text,
            help="serve metrics for Prometheus: the first supernode at this address; the other supernodes, the "
            "front-end and the hosts at the next ports, in this order",
        ),
    )
    log_level: str = field(
        default="warning",
        metadata=setting(metavar="LEVEL", choices=LEVELS, help="log messages of this level and above"),
    )

    @property
    def directory(self) -> Path | None:
        """The folder of the directory, which an archive needs at the next start; None without an archive.

        Each object store has a directory of its own, because it has archives of other channels.
        """
        if self.archive is None:
            return None
        if isinstance(self.archive, Path):
            return self.archive / "directory"
        digest = hashlib.sha256(str(self.archive).encode()).hexdigest()[:16]
        return (self.archive_folder or default_folder()) / f"directory-{digest}"

    def __post_init__(self) -> None:
        check_archive(self.archive, self.archive_folder)
        if self.web and find_spec(PAGE_MODULE) is None:
            raise ValueError("--web needs the extra [web] of stampede-rt; install it as you installed stampede-rt")
        if parse_address(self.listen).host in _WILDCARDS:
            raise ValueError(
                f"--listen: {self.listen!r} cannot be used; name one address of this machine: hosts and supernodes "
                "listen there, too, and tell clients so"
            )
