"""Makes the ids of clusters."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Mapping

from stampede_rt.cluster.cluster_ids import IN_MEMORY

ID_BYTES = 16
LISTED = "listed-"  # the ids that are made from a list of members begin with this


def new_cluster_id(*, in_memory: bool) -> str:
    """A random id. `in_memory`: for a cluster that ends with its processes."""
    return (IN_MEMORY if in_memory else "") + secrets.token_hex(ID_BYTES)


def listed_cluster_id(members: Mapping[str, str]) -> str:
    """The id of a cluster that is founded with a list of members. `members`: addresses by id. Equal lists give equal
    ids.
    """
    listed = "\n".join(f"{member_id}={address}" for member_id, address in sorted(members.items()))
    return LISTED + hashlib.sha256(listed.encode()).hexdigest()[: 2 * ID_BYTES]


def cluster_id_of(log_cluster_id: str) -> str:
    """The cluster's public id, from the id that its members use among each other; empty if the members' id is made from
    a list.
    """
    return "" if log_cluster_id.startswith(LISTED) else log_cluster_id
