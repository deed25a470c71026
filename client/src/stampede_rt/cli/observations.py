"""The answers of a cluster's parts, and the form of a finding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

FRONTEND, SUPERNODE, HOST, PEER, CALLER = "front-end", "supernode", "host", "peer", "this caller"


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """The facts about one part of a cluster, or the reason why the part did not answer (`failure`).

    - `clock_offset_nanos`: how far the part's clock is ahead of the caller's clock. The error is at most half of the
      round trip.
    - `alive`: whether the directory says that a host lives. `lease_held`: whether the host says that it has its lease.
    - `knows_supernodes`: whether a front-end knows supernodes.
    - `lost_for_nanos`: the time since the directory ended the lease of a host that did not deregister.
    - `refused_items`: the number of items that a host refused as Overloaded since its start, the last one
      `refused_ago_nanos` ago. `refused_for_archive`: whether the last refusal was for lack of room in the archive.
    - `refused_calls`: the number of calls that a host refused or ended as Overloaded since its start, the last one
      `refused_call_ago_nanos` ago.
    - `busy_permille`: the share of a core that a host used by its last report to the directory, in thousandths; None if
      the directory knows none.
    - `denials`: the number of calls that the part denied since its start, the last one `denied_ago_nanos` ago. The
      reason was the caller's credential or role, or a rule of access.
    - `quota_refusals`: the number of calls that the part refused since its start because their callers were beyond a
      quota, the last one `quota_refused_ago_nanos` ago.
    - `limits_caller`: whether rules of access limit the caller, so that listings may leave out things.
    - `is_member`: whether the supernodes list this supernode as a member.
    - `archive_failure`: why the archive of a host takes no items of `archive_failing_channels` channels now.
    - `archive_store_failure`: why the object store of the archive of a host failed last.
    - `in_memory`: whether a supernode keeps the directory only in memory.
    - `refuses_caller`: the part runs, but the caller's secret or certificate, or the part's certificate, is wrong.
    - `refused_because`: why other supernodes refuse the store of this supernode.

    The facts about a peer come from the leader. The round trip of a peer is the sum of two round trips: from the caller
    to a supernode, and from the peer to that supernode.
    """

    kind: str
    address: str
    name: str = ""
    failure: str = ""
    ready: bool = True
    alive: bool = True
    lease_held: bool = True
    knows_supernodes: bool = True
    is_member: bool = True
    lost_for_nanos: int | None = None
    refused_items: int = 0
    refused_ago_nanos: int | None = None
    refused_for_archive: bool = False
    refused_calls: int = 0
    refused_call_ago_nanos: int | None = None
    denials: int = 0
    denied_ago_nanos: int | None = None
    quota_refusals: int = 0
    quota_refused_ago_nanos: int | None = None
    limits_caller: bool = False
    busy_permille: int | None = None
    held_bytes: int = 0
    memory_bytes_max: int = 0
    archive_failure: str = ""
    archive_failing_channels: int = 0
    archive_store_failure: str = ""
    in_memory: bool = False
    refuses_caller: bool = False
    refused_because: str = ""
    round_trip_nanos: int | None = None
    clock_offset_nanos: int | None = None
    version: str = ""
    # The cluster's feature level as a supernode knows it, and the highest level of its release. 0: not known.
    feature_level: int = 0
    highest_feature_level: int = 0
    certificate_left_s: float | None = None
    certificate_lasts_s: float = float("inf")  # from the beginning to the end of the certificate's validity

    @property
    def clock_doubt_nanos(self) -> int:
        """The greatest error of the clock offset: half of the round trip."""
        return (self.round_trip_nanos or 0) // 2

    @property
    def part(self) -> str:
        """The kind and name of the part, for people."""
        return f"{self.kind} {self.name}".strip()


@dataclass(frozen=True, kw_only=True, slots=True)
class Inventory:
    """The channels, or the queues, of the directory: their number, and the names and hosts of the lost ones.

    `recorded`: the names and hosts of the recorded channels whose hosts are unreachable. The archives have their items.
    `is_partial`: rules of access limit the caller, so there may be others.
    """

    kind: str
    count: int
    lost: Sequence[tuple[str, str]] = ()
    recorded: Sequence[tuple[str, str]] = ()
    is_partial: bool = False


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One finding. `advice` is empty if nothing is wrong."""

    part: str
    address: str
    state: str
    advice: str = ""
    seen: Observation | None = None
