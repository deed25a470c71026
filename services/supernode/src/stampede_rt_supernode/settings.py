"""The settings of a supernode."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from stampede_rt.cluster.addresses import is_loopback
from stampede_rt.errors import StampedeError
from stampede_rt.values.policy import parse_name
from stampede_rt_runtime.cluster_ids import listed_cluster_id
from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import setting
from stampede_rt_runtime.values import parse_address, parse_address_text, parse_duration, parse_list, parse_target
from stampede_rt_supernode.core.lease import LEASE_TTL_NANOS

if TYPE_CHECKING:
    from stampede_rt_supernode.joining.founding import FoundingRecord

DEFAULT_ID = "supernode-1"
MEMBERS_MAX = 9  # with more members, each majority costs more than the added safety is worth
LEASE_TTL_NANOS_MIN, LEASE_TTL_NANOS_MAX = 10**9, 3600 * 10**9


def parse_member(text: str) -> str:
    """`ID=HOST:PORT`, checked and in its plain form. Raises ValueError."""
    member_id, equals, address = text.partition("=")
    if not equals or not member_id.strip():
        raise ValueError('ID=HOST:PORT for each member, such as "s1=localhost:7581,s2=localhost:7582"')
    return f"{member_id.strip()}={parse_target(address)}"


@dataclass(frozen=True, kw_only=True)
class SupernodeSettings(ServiceSettings):
    """Runs one replica of the directory, as the only supernode or with other members, of which a majority must run.

    `stampede supernode init` or `join` prepares its data folder. `status`, `add`, `remove` and `snapshot` are for
    supernodes that run. Each has --help.
    """

    listen: str = field(
        default="localhost:7590",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_address_text,
            help="the address at which the supernode listens; a single supernode may use port 0: any free port",
        ),
    )
    advertise: str = field(
        default="",
        metadata=setting(
            metavar="HOST:PORT",
            parse=parse_target,
            help="the address at which others reach the supernode; default: its address in --members, or, without "
            "--members, --listen",
        ),
    )
    id: str = field(
        default="",
        metadata=setting(
            metavar="ID",
            help=f"the supernode's id; no later member may use this id; default: {DEFAULT_ID} for a single supernode",
        ),
    )
    members: tuple[str, ...] = field(
        default=(),
        metadata=setting(
            metavar="ID=HOST:PORT,...",
            parse=parse_list(parse_member),
            help="all members, including this one; each member has the same list; default: this is the only supernode",
        ),
    )
    data_dir: Path | None = field(
        default=None,
        metadata=setting(
            metavar="DIR",
            help="the folder of the supernode's log; default: none, the log is in memory and is lost when the "
            "supernode stops",
        ),
    )
    zone: str = field(
        default="",
        metadata=setting(
            metavar="ZONE", help="the network or site of this supernode; callers prefer supernodes of their zone"
        ),
    )
    lease_ttl_nanos: int = field(
        default=LEASE_TTL_NANOS,
        metadata=setting(
            metavar="DURATION",
            parse=parse_duration,
            minimum=LEASE_TTL_NANOS_MIN,
            maximum=LEASE_TTL_NANOS_MAX,
            help="the lease of each host; a new cluster stores this value, and later values have no effect",
        ),
    )

    def __post_init__(self) -> None:
        ids = [member.partition("=")[0] for member in self.members]
        for name in {*ids, self.id} - {""}:
            parse_name(name, "supernode")
        if len(set(ids)) != len(ids):
            raise ValueError(f"--members names an id twice: {', '.join(ids)}; give every member an id of its own")
        addresses = [member.partition("=")[2] for member in self.members]
        if len(set(addresses)) != len(addresses):
            text = f"--members names an address twice: {', '.join(addresses)}"
            raise ValueError(f"{text}; give every member an address of its own")
        if len(ids) > MEMBERS_MAX:
            raise ValueError(f"--members names {len(ids)} members; {MEMBERS_MAX} at most")
        if self.members and self.id not in ids:
            raise ValueError(
                f"--id is {self.id!r}, and --members names {', '.join(ids)}: say with --id which of them this "
                "supernode is, or, if it is to enter a running cluster, use `stampede supernode join` instead"
            )
        here = [member for member in self.members if is_loopback(member.partition("=")[2])]
        if here and len(here) < len(self.members):
            raise ValueError(
                f"--members names {', '.join(here)}, which only its own machine can call, and also members of other "
                "machines; give each the address at which the others reach it"
            )
        if self.members and parse_address(self.listen).port == 0:
            raise ValueError(
                f"--listen is {self.listen}; with --members name the port that the list has for this supernode"
            )

    def founding(self, listening_at: str) -> FoundingRecord:
        """Returns how this supernode begins: as its folder was prepared, by the list of members, or as the only one.

        Raises StampedeError if it would begin as the only one in a folder that was never prepared and that holds no
        store. It may be a member that lost its disk. Such a member would not know its own votes and acknowledged
        entries.
        """
        from stampede_rt_supernode.joining.founding import check_restored, read_founding
        from stampede_rt_supernode.replication import holds_store

        if self.data_dir is not None:
            check_restored(self.data_dir)
        prepared = None if self.data_dir is None else read_founding(self.data_dir)
        if prepared is not None:
            if self.id not in ("", prepared.supernode_id):
                raise StampedeError(
                    f"{self.data_dir} is supernode {prepared.supernode_id}'s, not {self.id}'s: name the folder of "
                    f"{self.id}, or leave --id out"
                )
            return prepared
        if self.members:
            members = dict(self._pairs())
            return self._listed(self.id, members[self.id], members)
        name, address = self.id or DEFAULT_ID, self.advertise or listening_at
        if self.data_dir is not None and not holds_store(self.data_dir):
            raise StampedeError(
                f"{self.data_dir} holds no supernode yet: if this supernode was a member, name its own folder, or let "
                "it join under a new id; to enter a cluster, use `stampede supernode join`; to found one, `stampede "
                "supernode init`, or --members for all its founders"
            )
        if self.data_dir is not None:
            self._check_founder(self.data_dir, name)
        return self._listed(name, address, {name: address})

    @staticmethod
    def _check_founder(data_dir: Path, name: str) -> None:
        """Raises StampedeError if the store in the folder belongs to another supernode than `name`.

        That happens when a founder of a listed cluster is started without the list.
        """
        from stampede_rt_supernode.replication import StoreDamaged, StoreRefused, read_identity

        with contextlib.suppress(StoreDamaged, StoreRefused):  # the opening of the store reports these
            _, member_id = read_identity(data_dir)
            if member_id != name:
                raise StampedeError(
                    f"{data_dir} is supernode {member_id}'s, which was started with --members before: start it "
                    f"with --id {member_id} and the same --members"
                )

    def _listed(self, name: str, address: str, members: dict[str, str]) -> FoundingRecord:
        """Returns how a founder in the list of members begins.

        The cluster id comes from the store, if there is one, because the list may change later. Without a store it
        comes from the list.
        """
        from stampede_rt_supernode.joining.founding import FoundingRecord
        from stampede_rt_supernode.replication import StoreDamaged, StoreRefused, holds_store, read_identity

        cluster_id = listed_cluster_id(members)
        if self.data_dir is not None and holds_store(self.data_dir):
            with contextlib.suppress(StoreDamaged, StoreRefused):  # the opening of the store reports these
                cluster_id, _ = read_identity(self.data_dir)
        return FoundingRecord(
            supernode_id=name, address=address, members=members, log_cluster_id=cluster_id, listed=True
        )

    def _pairs(self) -> Iterator[tuple[str, str]]:
        for member in self.members:
            member_id, _, address = member.partition("=")
            yield member_id, address
