"""The clients of other languages and the cluster that they talk to."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.polyglot.toolchains import PREPARE, Client, Unavailable
from tests.support.cluster import running_cluster


@pytest.fixture(scope="package")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    """Two hosts with archives, one supernode, one front-end: real processes."""
    archive = tmp_path_factory.mktemp("archive")
    with running_cluster(hosts=2, supernodes=1, durable=False, archive=archive) as running:
        yield running


@pytest.fixture(scope="package")
def client_in() -> Callable[[str], Client]:
    """Makes the client of a language ready, once; skips with the reason where that cannot be done here."""
    ready: dict[str, Client] = {}

    def prepare(language: str) -> Client:
        try:
            return ready.setdefault(language, ready.get(language) or PREPARE[language]())
        except Unavailable as reason:
            pytest.skip(f"no client in {language}: {reason}")

    return prepare
