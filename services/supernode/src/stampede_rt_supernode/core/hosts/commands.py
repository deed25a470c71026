"""Commands about hosts, and their results (paper, section 4.2). Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_supernode.core.commands import Operation, Success
from stampede_rt_supernode.core.records import Endpoint, HostLoad, HostRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class RegisterHost(Operation):
    """A host registers. If its boot incarnation is new, its channels and queues get `new_incarnation`.

    `registration_epoch`: see `registration_epochs`. `continues_boot_incarnation`: the boot incarnation of the host's
    former process, if its archive has all items of its recorded channels; otherwise 0. `move_key`: see `move_permits`;
    empty: it has none. `is_private`, `machine`: see HostLoad. `archive_wait_nanos`, `archive_place`: see
    HostRecord.
    """

    host_id: bytes
    name: str
    gatekeepers: tuple[Endpoint, ...]
    boot_incarnation: int
    version: str = ""
    new_incarnation: int
    registration_epoch: int = 0
    has_archive: bool = False
    continues_boot_incarnation: int = 0
    move_key: bytes = field(default=b"", repr=False)
    is_private: bool = False
    machine: str = ""
    archive_wait_nanos: int = 0
    archive_place: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class DeregisterHost(Operation):
    """A host ends its own registration, because it stops."""

    host_id: bytes
    boot_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ExpireHost(Operation):
    """The leader of `tenure` notes that the lease of one registration has ended."""

    host_id: bytes
    boot_incarnation: int
    registered_index: int
    tenure: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ReportedLoad:
    """The load of one registration of a host."""

    host_id: bytes
    registered_index: int
    load: HostLoad


@dataclass(frozen=True, kw_only=True, slots=True)
class NoteHostLoads(Operation):
    """The leader of `tenure` notes the loads that hosts have reported to it; see `placement`."""

    tenure: int
    loads: tuple[ReportedLoad, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class HostRegistered(Success):
    """The host is registered."""

    host: HostRecord
    cluster_id: str


@dataclass(frozen=True, kw_only=True, slots=True)
class HostDeregistered(Success):
    """The host is deregistered."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HostExpired(Success):
    """`expired`: whether the command ended the lease. A command that came too late changed nothing."""

    expired: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class HostLoadsNoted(Success):
    """`noted`: the number of hosts whose load the command changed."""

    noted: int
