"""The findings of `doctor` about a supernode of another cluster, such as a restored backup at a member's address."""

from __future__ import annotations

import pytest

from stampede_rt.cli.asked_parts import PartAnswer
from stampede_rt.cli.examining import _cluster_of_most, _marked_if_foreign, _of_others
from stampede_rt.cli.observations import SUPERNODE, Observation
from stampede_rt.v1 import directory_service_pb2 as pb


def answer(name: str, cluster_id: str | None) -> PartAnswer:
    """The answer of a supernode; None: it did not answer."""
    seen = Observation(kind=SUPERNODE, address=f"{name}:1", name=name)
    if cluster_id is None:
        return PartAnswer(None, seen)
    return PartAnswer(pb.DirectoryServicePingResponse(supernode_id=name, cluster_id=cluster_id, ready=True), seen)


@pytest.mark.parametrize(
    ("clusters", "strangers"),
    [
        (("c", "c", "c"), ""),
        (("c", "d", "c"), "b"),
        (("d", None, "c"), "c"),
        (("", "c", None), ""),
        ((None, None, None), ""),
    ],
)
def test_doctor_examines_the_cluster_of_most_supernodes(clusters: tuple[str | None, ...], strangers: str) -> None:
    answers = [answer(name, cluster_id) for name, cluster_id in zip("abc", clusters, strict=True)]
    own_id = _cluster_of_most(answers)
    assert "".join(one.seen.name for one in answers if _of_others(one, own_id)) == strangers
    for one in answers:
        counts = _marked_if_foreign(one, own_id)
        if one.seen.name in strangers:
            assert f"of another cluster, {one.response.cluster_id}, answers there" in counts.seen.failure
        else:
            assert counts is one
