"""If the demo cannot run, the orchestrator reports the reason in one sentence."""

import io

import pytest

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.progress import Progress
from stampede_rt_demos.tv_watcher import orchestrator
from stampede_rt_demos.tv_watcher.orchestrator import conduct
from stampede_rt_local.process import ServiceFailed

STORY = "supernode s1 ended with exit code 1; its last lines:\n    starting\n    no space left on device"


class BrokenCluster:
    """A cluster whose start fails."""

    failure: Exception = ServiceFailed(STORY)

    def __init__(self, **settings: object) -> None:
        pass

    def __enter__(self) -> "BrokenCluster":
        raise self.failure

    def __exit__(self, *exc_info: object) -> None:
        raise AssertionError("a cluster whose start failed is not stopped")


@pytest.mark.parametrize(
    ("failure", "sentence"),
    [
        (
            ServiceFailed(STORY),
            "the cluster did not start: supernode s1 ended with exit code 1: no space left on device",
        ),
        (
            ServiceFailed(f"{STORY}\n      | KeyError: 'a'\n      +------------------"),
            "the cluster did not start: supernode s1 ended with exit code 1: KeyError: 'a'",
        ),
        (
            OSError("no 4 free ports at localhost"),
            "the cluster did not start: no 4 free ports at localhost",
        ),
        (
            st.Unavailable("nobody answers at localhost:1"),
            "the cluster does not answer as it should: nobody answers at localhost:1",
        ),
    ],
)
def test_a_cluster_that_fails_is_reported_in_one_sentence(monkeypatch, failure, sentence):
    monkeypatch.setattr(BrokenCluster, "failure", failure)
    monkeypatch.setattr(orchestrator, "LocalCluster", BrokenCluster)
    with pytest.raises(DemoFailed) as caught:
        conduct(2, Progress(io.StringIO()))
    assert str(caught.value) == sentence


def test_a_missing_film_is_reported_before_a_cluster_is_started(monkeypatch):
    monkeypatch.setattr("stampede_rt_demos.staging.film._FILM_PACKAGE", "no_such_package")
    monkeypatch.setattr(orchestrator, "LocalCluster", BrokenCluster)
    with pytest.raises(DemoFailed, match="the film is not here"):
        conduct(2, Progress(io.StringIO()))
