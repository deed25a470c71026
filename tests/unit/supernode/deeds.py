"""Commands for tests, with ids that are short to write: the same arguments, the same command."""

from __future__ import annotations

from itertools import count

from stampede_rt.model import Policy
from stampede_rt_supernode.commands import (
    BeginTenure,
    Command,
    Deed,
    DeleteChannel,
    DeregisterHost,
    ExpireHost,
    OpenChannel,
    RegisterHost,
    Result,
    UpdateChannel,
)
from stampede_rt_supernode.directory import Directory
from stampede_rt_supernode.records import Endpoint

TTL_NANOS = 5 * 10**9


def id_of(number: int) -> bytes:
    return number.to_bytes(16, "big")


class Log:
    """Applies commands to a directory at growing positions, with a new operation id each unless one is given."""

    def __init__(self, *, founded: bool = True) -> None:
        self.directory = Directory()
        self._index = 0
        self._op_ids = count(1)
        if founded:
            self.apply(begin_tenure(1))

    def apply(self, deed: Deed, op_id: bytes | None = None) -> Result:
        self._index += 1
        op_id = op_id or id_of(10_000 + next(self._op_ids))
        return self.directory.apply(self._index, Command(op_id=op_id, time_unix_nano=0, deed=deed))


def begin_tenure(tenure: int = 1) -> BeginTenure:
    return BeginTenure(tenure=tenure, supernode_id="s1", new_cluster_id=f"c{tenure}", new_lease_ttl_nanos=TTL_NANOS)


def register(number: int, *, name: str = "", boot: int = 1, incarnation: int = 900) -> RegisterHost:
    return RegisterHost(
        host_id=id_of(number),
        name=name or f"host-{number}",
        gatekeepers=(Endpoint(target=f"localhost:{7000 + number}", zone="lab"),),
        boot_incarnation=boot,
        version="0.1.0",
        new_incarnation=incarnation,
    )


def deregister(number: int, *, boot: int = 1) -> DeregisterHost:
    return DeregisterHost(host_id=id_of(number), boot_incarnation=boot)


def expire(number: int, *, boot: int = 1, registered_index: int, tenure: int = 1) -> ExpireHost:
    return ExpireHost(host_id=id_of(number), boot_incarnation=boot, registered_index=registered_index, tenure=tenure)


_channel_numbers = count(500)


def open_channel(
    name: str, *, host: str = "", create: bool = True, incarnation: int = 77, **policy: int | str
) -> OpenChannel:
    return OpenChannel(
        name=name,
        policy=Policy(**policy),  # type: ignore[arg-type]
        create=create,
        host_name=host,
        new_channel_id=id_of(next(_channel_numbers)),
        new_incarnation=incarnation,
    )


def update(channel_id: bytes, epoch: int, **policy: int | str) -> UpdateChannel:
    return UpdateChannel(channel_id=channel_id, epoch=epoch, policy=Policy(**policy))  # type: ignore[arg-type]


def delete(channel_id: bytes) -> DeleteChannel:
    return DeleteChannel(channel_id=channel_id)
