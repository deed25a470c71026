"""Gives each role a client token or certificate of its own, and makes rules that allow only the calls of the role."""

from __future__ import annotations

import os
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from stampede_rt.administration.running_cluster import Cluster, reached
from stampede_rt.v1 import access_pb2
from stampede_rt.v1 import access_service_pb2 as pb
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.identity import Role

VALID_NANOS = 3600 * 10**9


class Right(NamedTuple):
    """One right of a role. `verbs` and `kind` are as in `stampede acl add`; `names` may be a pattern."""

    verbs: Sequence[str]
    kind: str
    names: str


def caller_name(role: str) -> str:
    """The name in a role's token or certificate. The role's peer has the same name."""
    return role.replace(" ", "-")


def operator_credentials(cluster: LocalCluster) -> dict[str, Any]:
    """The `secret` and `tls` with which the demo itself calls the cluster, as an operator."""
    files = cluster.tls_files("demo", Role.OPERATOR)
    return {"secret": None if files else cluster.secret.text, "tls": files}


def hand_out(
    cluster: LocalCluster, rights: Mapping[str, Sequence[Right]], operator: Mapping[str, Any]
) -> dict[str, dict[str, str]]:
    """Make the rules, and a token or certificate for each role. Returns each role's environment.

    `operator`: see `operator_credentials`. The rules are in force on return. The roles get certificates if the cluster
    has certificates.

    Each role may also register the peer of its own name. Raises DemoFailed, StampedeError.
    """
    environments = {}
    with reached(cluster.address, None, **operator) as supernodes:
        version = 0
        for role, theirs in rights.items():
            name = caller_name(role)
            version = max(_allow(supernodes, name, one) for one in (*theirs, Right(("register",), "peer", name)))
            environments[role] = _credential(cluster, supernodes, name)
        if behind := supernodes.parts_behind(version, of_rules=True):
            raise DemoFailed(f"the rules of access are not in force at {', '.join(behind)}; run the demo again")
    return environments


def _credential(cluster: LocalCluster, supernodes: Cluster, name: str) -> dict[str, str]:
    """Make a token or certificate for a role. Returns the variables that name its files."""
    if files := cluster.tls_files(name):
        paths = {"CA": files.ca, "CERTIFICATE": files.certificate, "KEY": files.key}
        return {f"STAMPEDE_TLS_{variable}": str(path) for variable, path in paths.items()}
    token = supernodes.issue_client_token(name, ["client"], valid_nanos=VALID_NANOS).token
    assert cluster.folder is not None, "a cluster with a data folder"
    return {"STAMPEDE_SECRET_FILE": str(_write(cluster.folder / f"{name}.token", token))}


def _allow(supernodes: Cluster, who: str, right: Right) -> int:
    rule = access_pb2.AccessRule(
        who=who,
        verbs=[getattr(access_pb2, f"ACCESS_VERB_{verb.upper()}") for verb in right.verbs],
        kind=getattr(access_pb2, f"ACCESS_KIND_{right.kind.upper()}"),
        names=right.names,
    )
    request = pb.AddAccessRuleRequest(request_id=secrets.token_bytes(16), rule=rule)
    return int(supernodes.ask_access("AddAccessRule", request).version)


def _write(path: Path, token: str) -> Path:
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(token + "\n")
    return path
