"""An operator of a running cluster: makes rules and tokens, and removes its rules at the end."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager

from stampede_rt.administration.running_cluster import Cluster, reached
from stampede_rt.cli.commands import run
from stampede_rt.v1 import access_service_pb2 as pb
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.access.messages import rule_message
from stampede_rt_runtime.access.rules import AccessKind, AccessRule, AccessVerb


class Operator:
    """Adds and removes rules. A change is in force when `add` or `rm` returns."""

    def __init__(self, cluster: LocalCluster, supernodes: Cluster) -> None:
        self.cluster, self._supernodes = cluster, supernodes
        self._tokens: dict[str, str] = {}
        self._rules: list[tuple[str, ...]] = []

    def run(self, *words: str) -> int:
        """Run a command of the command line at this cluster. Returns its exit status."""
        return run([*words, "--url", self.cluster.address])

    def token(self, name: str) -> str:
        if name not in self._tokens:
            self._tokens[name] = self.new_token(name, 3600 * 10**9)
        return self._tokens[name]

    def new_token(self, name: str, valid_nanos: int) -> str:
        """A new token that is valid for `valid_nanos`."""
        return str(self._supernodes.issue_client_token(name, ["client"], valid_nanos=valid_nanos).token)

    def add(self, *rule: str) -> None:
        """Add a rule, as `stampede acl add`: who, verbs, names, and optionally "--kind" with a kind, or "--deny"."""
        self._change("AddAccessRule", rule)
        self._rules.append(rule)

    def rm(self, *rule: str) -> None:
        self._change("RemoveAccessRule", rule)
        self._rules.remove(rule)

    def keep_rules(self) -> None:
        """Keep the rules that were added until now. Only later ones are removed at the end."""
        self._rules.clear()

    def take_back(self) -> None:
        for rule in tuple(self._rules):
            self.rm(*rule)

    def _change(self, rpc: str, rule: tuple[str, ...]) -> None:
        who, verbs, names, *options = rule
        made = AccessRule(
            who=who,
            verbs=() if verbs == "*" else tuple(sorted(map(AccessVerb, verbs.split(",")))),
            kind=AccessKind(options[options.index("--kind") + 1]) if "--kind" in options else None,
            names=names,
            deny="--deny" in options,
        )
        request = getattr(pb, f"{rpc}Request")(request_id=secrets.token_bytes(16), rule=rule_message(made))
        changed = self._supernodes.ask_access(rpc, request)
        assert self._supernodes.parts_behind(changed.version, of_rules=True) == {}


@contextmanager
def operating(cluster: LocalCluster) -> Iterator[Operator]:
    """Yield an operator, and remove its rules at the end.

    A cluster without certificates knows the operator by its secret. In a cluster with certificates, the environment
    names the operator's certificate.
    """
    secret = cluster.secret.text if cluster.certificates is None else None
    with reached(cluster.address, None, secret=secret) as supernodes:
        made = Operator(cluster, supernodes)
        try:
            yield made
        finally:
            made.take_back()
