"""Which introductions a member refuses for the release of the caller, and what that does to the caller."""

from __future__ import annotations

from typing import Any

import grpc
import pytest

from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.network.greetings import HelloRefusal, introduction, refusal_of
from stampede_rt_supernode.replication.network.links import PeerLinks
from stampede_rt_supernode.replication.replica import MemberRoster
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION, ReplicationSettings
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.storage.store import Promise

SELF, OTHER = Member(member_id="s1", address="s1:1"), Member(member_id="s2", address="s2:1")
ROSTER = MemberRoster((SELF, OTHER), {"s1": SELF, "s2": OTHER}, frozenset())
OTHERS_STORE = "the store with which s2 came before"


def refused(*, knows: int = 2, cluster: int = 2, **changes: Any) -> HelloRefusal | None:
    """What s1, of a cluster at level `cluster`, says to s2, whose release knows level `knows`."""
    of_s2, of_s1 = (ReplicationSettings(self_member=one, initial_members=[SELF, OTHER]) for one in (OTHER, SELF))
    hello = introduction(of_s2, "s1", store_id=OTHERS_STORE, standing=(3, 7), roster=ROSTER, highest_level=knows)
    for name, value in changes.items():
        setattr(hello, name, value)
    stores = KnownStores(known={"s2": OTHERS_STORE})
    return refusal_of(hello, of_s1, roster=ROSTER, stores=stores, promise=Promise(3, 7), feature_level=cluster)


def test_a_release_that_knows_the_clusters_level_or_more_is_heard() -> None:
    assert refused(knows=2, cluster=2) is None
    assert refused(knows=3, cluster=2) is None


def test_a_release_that_knows_less_is_refused_and_its_member_ends_with_a_folder_as_good_as_before() -> None:
    refusal = refused(knows=1, cluster=2)
    assert refusal is not None
    assert refusal.code is grpc.StatusCode.FAILED_PRECONDITION
    settings = ReplicationSettings(self_member=OTHER, initial_members=[SELF, OTHER])
    links = PeerLinks(settings, lambda address: pytest.fail("nobody is called"), None, lambda error: None)  # type: ignore[arg-type]
    noted: list[object] = []
    links.on_refusal_confirmed = noted.append
    links._on_refused("s1", f"{refusal.code.name}: {refusal.why}", noted.append)
    assert links.too_old == "it knows feature level 1, and the cluster is at level 2"
    assert noted == []
    assert not links.refusals.by


@pytest.mark.parametrize("version", [PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1])
def test_another_version_of_the_protocol_is_refused_before_anything_else_is_looked_at(version: int) -> None:
    refusal = refused(knows=0, protocol_version=version, store_id="", term=0)
    assert refusal is not None
    assert f"speaks version {PROTOCOL_VERSION} of the log's protocol, not {version}" in refusal.why
    assert "stop all supernodes" in refusal.why
