"""The introductions that a member refuses because of the caller's release, and the effect on the caller."""

from __future__ import annotations

from typing import Any

import grpc
import pytest

from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.network.hello import HelloRefusal, introduction, refusal_of
from stampede_rt_supernode.replication.network.links import PeerLinks
from stampede_rt_supernode.replication.network.refusals import RefusalGrounds
from stampede_rt_supernode.replication.raft_replica import MemberRoster
from stampede_rt_supernode.replication.settings import PROTOCOL_VERSION, ReplicationSettings
from stampede_rt_supernode.replication.storage.known_stores import KnownStores
from stampede_rt_supernode.replication.storage.store import Promise

SELF, OTHER = Member(member_id="s1", address="s1:1"), Member(member_id="s2", address="s2:1")
ROSTER = MemberRoster((SELF, OTHER), {"s1": SELF, "s2": OTHER}, frozenset())
OTHERS_STORE = "the store with which s2 came before"


def refused(*, knows: int = 2, cluster: int = 2, **changes: Any) -> HelloRefusal | None:
    """The refusal with which s1 answers the hello of s2; None if s1 accepts it.

    The cluster of s1 is at level `cluster`, and the release of s2 knows level `knows`.
    """
    s2_settings, s1_settings = (
        ReplicationSettings(self_member=one, initial_members=[SELF, OTHER]) for one in (OTHER, SELF)
    )
    hello = introduction(
        s2_settings, "s1", store_id=OTHERS_STORE, durable_end=(3, 7), roster=ROSTER, highest_level=knows
    )
    for name, value in changes.items():
        setattr(hello, name, value)
    stores = KnownStores(known={"s2": OTHERS_STORE})
    return refusal_of(hello, s1_settings, roster=ROSTER, stores=stores, promise=Promise(3, 7), feature_level=cluster)


def test_a_member_whose_release_knows_the_clusters_level_is_accepted() -> None:
    assert refused(knows=2, cluster=2) is None
    assert refused(knows=3, cluster=2) is None


class Links3(PeerLinks):
    """The links of s2, one of three members. `done`: the arguments of `on_refusal_confirmed` and `deliver`."""

    def __init__(self, leader_id: str | None = None) -> None:
        settings = ReplicationSettings(self_member=OTHER, initial_members=[SELF, OTHER])
        super().__init__(settings, lambda address: pytest.fail("nobody is called"), None, lambda error: None)  # type: ignore[arg-type]
        self.done: list[object] = []
        self.others_and_leader = lambda: ({"s1", "s3"}, leader_id)
        self.on_refusal_confirmed = self.done.append

    def take_refusal(self, member_id: str, refusal: HelloRefusal | None) -> None:
        """Note that the member has refused s2."""
        assert refusal is not None
        self._on_refused(member_id, f"{refusal.code.name}: {refusal.why}", self.done.append)


def test_a_member_of_an_older_release_is_refused_and_one_refusal_does_not_stop_it() -> None:
    refusal, links = refused(knows=1, cluster=2), Links3(leader_id="s3")
    assert refusal is not None
    assert refusal.code is grpc.StatusCode.FAILED_PRECONDITION
    for _ in range(3):
        links.take_refusal("s1", refusal)
    assert links.outdated.confirmed is None
    assert list(links.outdated.words_by_id) == ["s1"]


@pytest.mark.parametrize(("refusing", "leader_id"), [(["s1"], "s1"), (["s1", "s3"], None)])
def test_refusals_by_the_leader_or_most_members_stop_an_old_release_and_leave_its_folder_usable(
    refusing: list[str], leader_id: str | None
) -> None:
    links = Links3(leader_id)
    for member_id in refusing:
        links.take_refusal(member_id, refused(knows=1, cluster=2))
    assert links.outdated.confirmed is RefusalGrounds.TOO_OLD
    assert "it knows feature level 1, and the cluster is at level 2 (says s1" in links.outdated.why
    assert links.done == [], "s2's store is not disputed, and its folder has no mark"
    assert not links.refusals.words_by_id


def test_refusals_for_different_reasons_are_counted_separately() -> None:
    links = Links3()
    links.take_refusal("s1", refused(knows=1, cluster=2))
    links.take_refusal("s3", refused(term=0))
    assert links.outdated.confirmed is links.refusals.confirmed is None
    links.take_refusal("s1", refused(term=0))
    assert links.refusals.confirmed is RefusalGrounds.OLDER_STORE
    assert not links.outdated.words_by_id, "s1 refuses s2 for its store now, and no longer for its release"


@pytest.mark.parametrize("version", [PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1])
def test_another_version_of_the_protocol_is_refused_before_any_other_check(version: int) -> None:
    refusal = refused(knows=0, protocol_version=version, store_id="", term=0)
    assert refusal is not None
    assert f"speaks version {PROTOCOL_VERSION} of the log's protocol, not {version}" in refusal.why
    assert "stop all supernodes" in refusal.why
