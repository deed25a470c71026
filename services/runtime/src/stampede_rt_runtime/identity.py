"""The identity in a certificate: a URI `stampede://CLUSTER/ROLE/NAME` among its names. Pure."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from stampede_rt.values.policy import NAME_GRAMMAR

SCHEME = "stampede://"
_CLUSTER = re.compile(r"[a-z0-9][a-z0-9._-]{0,63}")  # the host part of a URI, which is not case-sensitive

_FILE_NAME = re.compile(r"[a-z0-9][a-z0-9._-]*")


class Role(StrEnum):
    """The role that a certificate or token gives to its owner."""

    SUPERNODE = "supernode"
    FRONTEND = "frontend"
    HOST = "host"
    CLIENT = "client"
    OPERATOR = "operator"  # a client that may also add and remove supernodes


SERVICES = frozenset({Role.SUPERNODE, Role.FRONTEND, Role.HOST})


@dataclass(frozen=True, slots=True)
class Identity:
    """One service or client of one cluster."""

    cluster: str
    role: Role
    name: str

    def __post_init__(self) -> None:
        if not _CLUSTER.fullmatch(self.cluster):
            raise ValueError(f"the cluster's name is {self.cluster!r}; allowed: {_CLUSTER.pattern}")
        if not re.fullmatch(NAME_GRAMMAR, self.name):
            raise ValueError(f"the name is {self.name!r}; allowed: {NAME_GRAMMAR}")

    def __str__(self) -> str:
        return f"{self.role} {self.name} of cluster {self.cluster}"

    @property
    def uri(self) -> str:
        """The URI in the certificate."""
        return f"{SCHEME}{self.cluster}/{self.role}/{self.name}"

    @property
    def file_stem(self) -> str:
        """The name of its files, without their endings. Different names have different stems, even on a file
        system that ignores case.

        A name with upper-case letters or "/" is not a valid file name. Its stem is another text, with a digest of the
        name.
        """
        if _FILE_NAME.fullmatch(self.name):
            return f"{self.role}-{self.name}"
        digest = hashlib.blake2b(self.name.encode(), digest_size=6).hexdigest()
        return f"{self.role}-{self.name.lower().replace('/', '-')}-{digest}"


def parse_identity(uri: str) -> Identity:
    """The identity of a URI. Raises ValueError, which gives the allowed form."""
    cluster, _, rest = uri.removeprefix(SCHEME).partition("/")
    role, _, name = rest.partition("/")
    if not uri.startswith(SCHEME) or role not in set(Role):
        raise ValueError(f"the URI is {uri!r}; write {SCHEME}CLUSTER/ROLE/NAME. The roles are {', '.join(Role)}")
    return Identity(cluster, Role(role), name)


def identity_among(uris: Iterable[str]) -> Identity | None:
    """The one identity among a certificate's URIs; None if there is none, an invalid one, or more than one."""
    ours = [uri for uri in uris if uri.startswith(SCHEME)]
    if len(ours) != 1:
        return None
    try:
        return parse_identity(ours[0])
    except ValueError:
        return None
