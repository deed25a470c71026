"""Real clusters for tests: `cluster = cluster_fixture(hosts=2)` in a test file makes a fixture of that name there."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.access.rules import VERBS_OF
from tests.support.operator import operating

LINES_SHOWN = 12
TESTER = "tester"
SECRET_VARIABLE = "STAMPEDE_SECRET_FILE"
_secret_files: dict[str, str] = {}  # by the address of each running cluster


def cluster_fixture(
    *, scope: Literal["function", "module", "package"] = "module", **settings: Any
) -> Callable[..., Iterator[LocalCluster]]:
    """Return a fixture with a running LocalCluster, made with `settings`. Clients in this process find its secret.

    A test that kills a part of its cluster needs a cluster of its own: scope="function". Clients find the secret of a
    cluster of a package only after `find_secret_of`, because two such clusters may run at the same time.
    """

    @pytest.fixture(scope=scope)
    def cluster() -> Iterator[LocalCluster]:
        with running_cluster(is_found=scope != "package", **settings) as made:
            yield made

    return cluster


def secured_cluster_fixture(**settings: Any) -> Callable[..., Iterator[LocalCluster]]:
    """Return a module's fixture with a running LocalCluster, made with `settings`, whose callers need certificates."""

    @pytest.fixture(scope="module")
    def cluster() -> Iterator[LocalCluster]:
        with pytest.MonkeyPatch.context() as patch, LocalCluster(tls=True, durable=False, **settings) as made:
            patch.delenv(SECRET_VARIABLE, raising=False)
            yield made

    return cluster


def recorded_cluster_fixture() -> Callable[..., Iterator[LocalCluster]]:
    """Return a module's fixture with a running LocalCluster of one host with an archive. Clients state its secret."""

    @pytest.fixture(scope="module")
    def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
        with LocalCluster(hosts=1, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
            yield running

    return cluster


def judges_tests() -> bool:
    """Whether the tests run as a client to which rules of access apply (`make test-acl`)."""
    return bool(os.environ.get("STAMPEDE_TEST_ACL"))


@contextmanager
def acting_as_operator(cluster: LocalCluster) -> Iterator[None]:
    """Let the clients that connect in the block act as operators, also under `make test-acl`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SECRET_VARIABLE, str(cluster.secret_file))
        yield


def drained(cluster: LocalCluster, host: str) -> st.DrainInfo:
    """Drain a host as an operator, also under `make test-acl`."""
    with acting_as_operator(cluster), st.connect(cluster.address, transport="grpc") as operator:
        return operator.drain(host)


def find_secret_of(cluster: LocalCluster, patch: pytest.MonkeyPatch) -> None:
    """Let the clients in this process find the secret or token of `cluster`, and not of a cluster that started
    later.
    """
    patch.setenv(SECRET_VARIABLE, _secret_files[cluster.address])


def with_rules(cluster: LocalCluster, folder: Path) -> Path:
    """Make rules that allow the tests every verb for every kind of thing. Returns the file of a token for the tests."""
    with operating(cluster) as operator:
        for kind, verbs in VERBS_OF.items():
            operator.add(f"{TESTER}*", ",".join(sorted(verbs)), "*", "--kind", kind)
        operator.add("*", "*", "no-test-uses-this/*", "--deny")
        operator.keep_rules()
        file = folder / "token"
        file.touch(mode=0o600)
        file.write_text(operator.token(TESTER))
    return file


@contextmanager
def running_cluster(
    planned: LocalCluster | None = None, *, is_found: bool = True, **settings: Any
) -> Iterator[LocalCluster]:
    """Yield a running LocalCluster, `planned` or made with `settings`.

    If `is_found`, `$STAMPEDE_SECRET_FILE` names its secret while it runs. At the end the last lines of its processes
    are printed, and pytest shows them if a test failed.
    """
    made = planned or LocalCluster(**settings)
    with made, tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv(SECRET_VARIABLE, str(made.secret_file))
        if judges_tests():
            patch.setenv(SECRET_VARIABLE, str(with_rules(made, Path(folder))))
        _secret_files[made.address] = os.environ[SECRET_VARIABLE]
        if not is_found:
            patch.undo()
        try:
            yield made
        finally:
            print_last_lines(made)


def print_last_lines(cluster: LocalCluster) -> None:
    """Print the last lines of all processes of a cluster. Pytest shows them if a test failed."""
    for process in cluster.processes():
        print(f"--- {process.name}", *process.last_lines[-LINES_SHOWN:], sep="\n")
