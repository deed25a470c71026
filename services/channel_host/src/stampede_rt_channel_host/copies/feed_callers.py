"""The check that the caller of a feed is the host that it claims to be."""

from __future__ import annotations

from stampede_rt.errors import PermissionDenied
from stampede_rt_channel_host.cluster.directory import DirectoryQueries
from stampede_rt_runtime.admission import caller_identity
from stampede_rt_runtime.rpc import Context

NAMES_MAX = 4096


class FeedCallers:
    """Compares the names in certificates with the hosts' names in the directory, which never change."""

    def __init__(self, directory: DirectoryQueries) -> None:
        self._directory = directory
        self._names: dict[bytes, str] = {}

    async def check(self, context: Context, host_id: bytes) -> None:
        """Raises PermissionDenied if the caller has the certificate of another host than `host_id`.

        The check is needed because, for example, the reports of a replica decide which puts are acknowledged. In a
        cluster without certificates every caller passes. Raises HostNotFound for a host that never registered.
        """
        caller = caller_identity(context)
        if caller is None:
            return
        name = self._names.get(host_id) or await self._directory.name_of_host(host_id)
        if len(self._names) < NAMES_MAX:
            self._names[host_id] = name
        if caller.name != name:
            reason = "its certificate must contain that name, because a host speaks only for itself"
            raise PermissionDenied(f"{caller} cannot act as host {name}: {reason}")
