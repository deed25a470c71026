"""Which cluster is which, and who may go over from one to another. Pure.

A host that followed whatever directory answers would leave its cluster for a backup that somebody restored at one of
its addresses. So hosts and front-ends stay with the cluster that they have met first. They go over to one that says it
takes the place of theirs (`supernode init --restore --take-over`), and from one that was kept in memory alone: that one
cannot come back.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Iterable, Mapping

IN_MEMORY = "memory-"
ID_BYTES = 16


def new_cluster_id(*, in_memory: bool) -> str:
    """A random id. `in_memory`: of a cluster that ends with its processes."""
    return (IN_MEMORY if in_memory else "") + secrets.token_hex(ID_BYTES)


def listed_cluster_id(members: Mapping[str, str]) -> str:
    """The id that all founders agree on who are given the same list, address by member id, and no others."""
    listed = "\n".join(f"{member_id}={address}" for member_id, address in sorted(members.items()))
    return "listed-" + hashlib.sha256(listed.encode()).hexdigest()[: 2 * ID_BYTES]


def may_go_over(own: str, to: str, to_former: Iterable[str]) -> bool:
    """Whether a part of cluster `own` (empty: of none yet) may be one of `to`, which took the place of `to_former`."""
    return not own or not to or own == to or own in to_former or own.startswith(IN_MEMORY)
