"""An operator of a running cluster: makes rules and tokens, and takes its rules back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stampede_rt.cli.commands import run
from stampede_rt_local.cluster import LocalCluster


class Operator:
    """Makes rules and tokens as an operator does, and takes its rules back."""

    def __init__(self, cluster: LocalCluster, folder: Path) -> None:
        self.cluster, self._folder = cluster, folder
        self.tokens: dict[str, str] = {}
        self._rules: list[tuple[str, ...]] = []

    def run(self, *words: str) -> int:
        return run([*words, "--url", self.cluster.address])

    def token(self, name: str) -> str:
        if name not in self.tokens:
            file = self._folder / f"{name}.token"
            assert self.run("token", "issue", name, "--out", str(file)) == 0
            self.tokens[name] = file.read_text().strip()
        return self.tokens[name]

    def add(self, *rule: str) -> None:
        assert self.run("acl", "add", *rule) == 0
        self._rules.append(rule)

    def rm(self, *rule: str) -> None:
        assert self.run("acl", "rm", *rule) == 0
        self._rules.remove(rule)

    def take_back(self) -> None:
        for rule in tuple(self._rules):
            self.rm(*rule)


@contextmanager
def operating(cluster: LocalCluster, folder: Path) -> Iterator[Operator]:
    """An operator whose rules are gone afterwards. `folder`: for its tokens."""
    made = Operator(cluster, folder)
    try:
        yield made
    finally:
        made.take_back()
