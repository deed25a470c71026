"""The cluster of a caller, and the moment at which it changes to another one."""

from __future__ import annotations

import pytest

from stampede_rt.cluster.call_metadata import CallMetadata
from stampede_rt.cluster.cluster_ids import (
    METADATA_KEY,
    ClusterSeen,
    cluster_among,
    cluster_metadata,
    may_change_to,
    named_cluster,
    wrong_cluster,
)
from stampede_rt.cluster.majority import why_unserved
from stampede_rt.errors import StampedeError, Unavailable, WrongCluster

STRANGER = WrongCluster("this supernode is of cluster y")


@pytest.mark.parametrize(
    ("own", "to", "former", "may"),
    [
        ("", "x", (), True),
        ("x", "", (), True),
        ("x", "x", (), True),
        ("x", "y", (), False),
        ("x", "y", ("w", "x"), True),
        ("memory-x", "memory-y", (), True),
        ("memory-x", "y", (), False),
        ("x", "memory-y", (), False),
    ],
)
def test_a_part_changes_only_to_the_successor_of_its_cluster_or_from_one_cluster_in_memory_to_another(
    own: str, to: str, former: tuple[str, ...], may: bool
) -> None:
    assert may_change_to(own, to, former) is may


def test_a_caller_stays_with_its_cluster_as_long_as_this_cluster_answers() -> None:
    successor = ClusterSeen("y", ("x",))
    assert cluster_among("x", [successor, ClusterSeen("x")]) == "x"
    assert cluster_among("x", [ClusterSeen("z"), successor]) == "y"
    assert cluster_among("x", [ClusterSeen("z"), ClusterSeen("")]) == "x"
    assert cluster_among("", [ClusterSeen(""), ClusterSeen("z")]) == "z"


def test_a_call_names_the_callers_cluster_as_soon_as_the_caller_knows_it() -> None:
    metadata = CallMetadata(lambda: "s")
    assert metadata() == (("authorization", "Bearer s"),)
    metadata.cluster_id = "x"
    assert metadata() == (("authorization", "Bearer s"), (METADATA_KEY, "x"))
    assert named_cluster(metadata()) == "x"
    assert (named_cluster(None), cluster_metadata("")) == ("", ())


def test_the_refusal_names_both_clusters_and_a_remedy_and_cuts_a_long_id() -> None:
    error = wrong_cluster("this supernode", "y", "x" * 1000)
    for part in ("of cluster y", f"of cluster {'x' * 64};", "remove the file cluster-id"):
        assert part in error.message
    assert error.metadata == {"cluster_id": "y"}


def test_a_supernode_of_another_cluster_counts_as_one_that_does_not_answer() -> None:
    answering = Unavailable("no majority of the supernodes answered", reason="NO_QUORUM")
    error = why_unserved({"a": answering, "b": answering, "c": STRANGER}, 3)
    assert error is answering
    error = why_unserved({"a": answering, "b": STRANGER, "c": STRANGER}, 3)
    assert "1 of 3 supernodes answer, 2 must answer (b is of another cluster, c is of another cluster)" in error.message


def test_the_error_says_that_all_supernodes_belong_to_another_cluster() -> None:
    failures: dict[str, StampedeError] = {"a": STRANGER, "b": STRANGER}
    assert why_unserved(failures, 2) is STRANGER
    assert why_unserved({"a": STRANGER}, 1) is STRANGER
