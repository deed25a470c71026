"""Real clusters for tests: `cluster = cluster_fixture(hosts=2)` in a test file makes a fixture of that name there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal

import pytest

from stampede_rt_local.cluster import LocalCluster

LINES_SHOWN = 12


def cluster_fixture(
    *, scope: Literal["function", "module", "session"] = "module", **settings: Any
) -> Callable[..., Iterator[LocalCluster]]:
    """Return a fixture with a running LocalCluster, made with `settings`. Clients in this process find its secret.

    A test that kills a part of it needs its own cluster: scope="function".
    """

    @pytest.fixture(scope=scope)
    def cluster() -> Iterator[LocalCluster]:
        with running_cluster(**settings) as made:
            yield made

    return cluster


@contextmanager
def running_cluster(planned: LocalCluster | None = None, **settings: Any) -> Iterator[LocalCluster]:
    """Yield a running LocalCluster, `planned` or made with `settings`.

    While it runs, `$STAMPEDE_SECRET_FILE` names its secret. At the end the last lines of its processes are printed, and
    pytest shows them if a test failed.
    """
    made = planned or LocalCluster(**settings)
    with pytest.MonkeyPatch.context() as patch, made:
        patch.setenv("STAMPEDE_SECRET_FILE", str(made.secret_file))
        try:
            yield made
        finally:
            for process in made.processes():
                print(f"--- {process.name}", *process.last_lines[-LINES_SHOWN:], sep="\n")
