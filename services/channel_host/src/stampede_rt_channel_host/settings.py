"""The settings of `stampede host`."""

from __future__ import annotations

import ipaddress
import os
import re
from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt.cluster.addresses import ADDRESSES_MAX
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.values.policy import NAME_GRAMMAR
from stampede_rt_runtime.archive_places import check_archive, folder_of, parse_archive
from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import setting
from stampede_rt_runtime.values import parse_address, parse_address_text, parse_list, parse_size, parse_target

MEMORY_BYTES_MIN = 2**20
PROCESSES_MAX = 256
FEED_TRANSPORTS = (Transport.BEST.value, Transport.GRPC.value, Transport.SOCKET.value, Transport.TCP.value)
PROCESS_MARK = "{process}"  # in the path of a certificate: the number of the process


def parse_processes(text: str) -> int:
    """A number of processes; `auto`: one for each core that this process may use. Raises ValueError."""
    if text.strip().lower() == "auto":
        return min(_cores(), PROCESSES_MAX)
    if not (text.strip().isascii() and text.strip().isdigit()):
        raise ValueError(f'a number from 1 to {PROCESSES_MAX}, or "auto"')
    return int(text)


def parse_feed_transport(text: str) -> str:
    """A transport of feeds. Raises ValueError."""
    if text not in FEED_TRANSPORTS:
        raise ValueError(f"one of {', '.join(FEED_TRANSPORTS)}")
    return text


def parse_group(text: str) -> str:
    """An IPv4 multicast group with a port, "GROUP:PORT". Raises ValueError."""
    group, _, port = text.strip().rpartition(":")
    example = "an IPv4 multicast group and a port, such as 239.255.7.5:7585"
    try:
        is_group = ipaddress.IPv4Address(group).is_multicast
    except ValueError:
        raise ValueError(example) from None
    if not (is_group and port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(example)
    return f"{group}:{int(port)}"


def parse_interface(text: str) -> str:
    """An IPv4 address of this machine. Raises ValueError."""
    try:
        return str(ipaddress.IPv4Address(text.strip()))
    except ValueError:
        raise ValueError("an IPv4 address of this machine, such as 10.0.0.5") from None


def _cores() -> int:
    """The number of cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS and Windows do not have it
        return os.cpu_count() or 1


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
    data_port: int | None = field(
        default=None,
        metadata=setting(
            metavar="PORT",
            minimum=0,
            maximum=65535,
            help="a second port at the same address, at which programs of other machines exchange data over TCP "
            "sockets, which takes less time than gRPC (0: any free port); they must reach it under the same number; "
            "default: none, they use gRPC",
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
    private: bool = field(
        default=False,
        metadata=setting(
            help="take only channels, queues and copies whose callers name this host; the directory places nothing here"
        ),
    )
    archive: Path | str | None = field(
        default=None,
        metadata=setting(
            metavar="PLACE",
            parse=parse_archive,
            help="the folder in which the host keeps recorded channels (those opened with `archive`), and, without "
            "--data-dir, its identity; or an object store, the same for all hosts of the cluster: s3://BUCKET/PREFIX, "
            "gs://, az:// or file:// (extra [objects]); default: none, the host records no channel",
        ),
    )
    archive_folder: Path | None = field(
        default=None,
        metadata=setting(
            metavar="FOLDER",
            help="with a URL in --archive: the folder of files that have not moved to the object store, of cached "
            "parts of objects, and, without --data-dir, of the host's identity; default: `archive` in --data-dir, or "
            "~/.local/state/stampede/archive",
        ),
    )
    archive_cache_bytes: int = field(
        default=2**30,
        metadata=setting(
            metavar="SIZE",
            parse=parse_size,
            minimum=0,
            help="the most bytes of objects that the host caches in --archive-folder for later reads; several "
            "processes have equal parts of it",
        ),
    )
    archive_move_seconds: int = field(
        default=600,
        metadata=setting(
            metavar="SECONDS",
            minimum=1,
            maximum=7 * 86400,
            help="after this time, and after 64 MiB, the host closes a file of a channel and moves it to the object "
            "store; if the machine is lost, so are the items of files that have not moved",
        ),
    )
    archive_wait_seconds: int = field(
        default=60,
        metadata=setting(
            metavar="SECONDS",
            minimum=0,
            maximum=7 * 86400,
            help="with a folder in --archive: when this host is unreachable, its recorded channels wait for it for "
            "this time; then they go to another host, which does not have their archived items; 0: they do not wait",
        ),
    )
    archive_bytes_max: int = field(
        default=0,
        metadata=setting(
            metavar="SIZE",
            parse=parse_size,
            minimum=0,
            help="the most bytes that the archive may use on its disk; beyond it the host refuses puts into recorded "
            "channels; several processes have equal parts of it; default: nine tenths of the room that the disk has "
            "at the start, so give it if several hosts or processes share a disk",
        ),
    )
    memory_bytes_max: int = field(
        default=4 * 2**30,
        metadata=setting(
            metavar="SIZE",
            parse=parse_size,
            minimum=MEMORY_BYTES_MIN,
            help="the most memory that all channels and queues may use together; beyond it the host refuses puts; "
            "several processes have equal parts of it",
        ),
    )
    metrics_names: str = field(
        default="*",
        metadata=setting(
            metavar="GLOB",
            help="with --metrics: the channels, queues and groups that may have metrics of their own, at most 100 of "
            'each, the busiest first; "" for none',
        ),
    )
    copy_bytes_per_second: int = field(
        default=0,
        metadata=setting(
            metavar="SIZE",
            parse=parse_size,
            minimum=0,
            help="the most bytes a second that each copy of a channel at this host takes from its source; default: no "
            "limit",
        ),
    )
    feed_transport: str = field(
        default=Transport.BEST.value,
        metadata=setting(
            metavar="TRANSPORT",
            parse=parse_feed_transport,
            help="how the feeds of copies reach other hosts: best (over a socket if the other host offers one, else "
            "gRPC), grpc, socket, or tcp (at the other host's --data-port)",
        ),
    )
    multicast: str = field(
        default="",
        metadata=setting(
            metavar="GROUP:PORT",
            parse=parse_group,
            help="an IPv4 multicast group and a port, such as 239.255.7.5:7585, to which the host sends each item once "
            "for all readers of its network that subscribe with via=multicast; all hosts may share one; default: none, "
            "it sends each reader its own copy",
        ),
    )
    multicast_interface: str = field(
        default="",
        metadata=setting(
            metavar="ADDRESS",
            parse=parse_interface,
            help="with --multicast: the IPv4 address of the network interface from which the host sends the datagrams; "
            "default: the address of --listen, or, if the host listens at all addresses, the system's choice",
        ),
    )
    multicast_bytes_per_second: int = field(
        default=48 * 2**20,
        metadata=setting(
            metavar="SIZE",
            parse=parse_size,
            minimum=10_000,
            help="with --multicast: the most bytes of datagrams that the host sends in a second; choose less than the "
            "slowest reader and its network can receive",
        ),
    )
    drain_seconds: int = field(
        default=5,
        metadata=setting(
            metavar="SECONDS",
            minimum=0,
            maximum=3600,
            help="after SIGTERM, the host moves its channels to other hosts for at most this time, and then ends; 0: "
            "it moves none",
        ),
    )
    processes: int = field(
        default=1,
        metadata=setting(
            metavar="N",
            parse=parse_processes,
            minimum=1,
            maximum=PROCESSES_MAX,
            help='how many host processes to run; "auto": one for each core; 2 or more processes have the names '
            "NAME-0, NAME-1 and so on, consecutive ports from --listen, --advertise, --data-port and --metrics on, and "
            f"their own folders in --data-dir; each process replaces {PROCESS_MARK} in --tls-certificate and --tls-key "
            "by its number",
        ),
    )

    def __post_init__(self) -> None:
        if not 0 < len(self.frontend) <= ADDRESSES_MAX:
            raise ValueError(f"--frontend names {len(self.frontend)} front-ends; allowed: 1 to {ADDRESSES_MAX}")
        if self.name and not re.fullmatch(NAME_GRAMMAR, self.name):
            raise ValueError(f"--name is {self.name!r}; allowed: {NAME_GRAMMAR}")
        check_archive(self.archive, self.archive_folder)
        if self.processes > 1:
            self._check_processes()

    @property
    def folder_of_archive(self) -> Path | None:
        """The folder of the archive on this machine; None: the host has no archive."""
        return folder_of(self.archive, self.archive_folder, self.data_dir)

    @property
    def archive_wait_nanos(self) -> int:
        """The time for which recorded channels wait for this host; 0 if other hosts have their archive, too."""
        return self.archive_wait_seconds * 10**9 if isinstance(self.archive, Path) else 0

    def _check_processes(self) -> None:
        """Check that each of the processes can have settings of its own. Raises ValueError."""
        last = self.processes - 1
        if self.name and not re.fullmatch(NAME_GRAMMAR, f"{self.name}-{last}"):
            raise ValueError(f"--name is {self.name!r}, too long for a name of each process; take a shorter one")
        for flag, text in (("--listen", self.listen), ("--advertise", self.advertise), ("--metrics", self.metrics)):
            if text and parse_address(text).port + last > 65535:
                raise ValueError(f"{flag} {text} leaves no ports for {self.processes} processes; take a lower port")
        if (self.data_port or 0) + last > 65535:
            raise ValueError(f"--data-port {self.data_port} leaves no ports for {self.processes} processes")
        if self.memory_bytes_max // self.processes < MEMORY_BYTES_MIN:
            raise ValueError(
                f"--memory-bytes-max leaves each of {self.processes} processes less than {MEMORY_BYTES_MIN} bytes; "
                "give more memory, or run fewer processes"
            )
        for flag, path in (("--tls-certificate", self.tls_certificate), ("--tls-key", self.tls_key)):
            if path is not None and PROCESS_MARK not in str(path):
                raise ValueError(
                    f"{flag} {path} names one file for {self.processes} processes, and a certificate names one host; "
                    f"issue one for each, and write {PROCESS_MARK} for the number, as in host-h1-{PROCESS_MARK}.pem"
                )
