"""The answers that `stampede doctor` believes."""

from __future__ import annotations

from stampede_rt.cli.asked_parts import PartAnswer
from stampede_rt.cli.examining import _refused_by
from stampede_rt.cli.observations import SUPERNODE, Observation
from stampede_rt.v1 import directory_service_pb2 as pb

REFUSED = {"s1": "'s1' comes with an older copy of its store"}


def answer(address: str) -> PartAnswer:
    """The answer of a part at this address: it calls itself s1, and says that it has refused REFUSED."""
    seen = Observation(kind=SUPERNODE, name="s1", address=address)
    return PartAnswer(pb.DirectoryServicePingResponse(supernode_id="s1", refused_supernodes=REFUSED), seen)


def test_the_answer_of_a_copy_at_another_members_address_does_not_count_for_the_member() -> None:
    listed = {"s1:1": "s1", "s2:1": "s2"}
    assert _refused_by(answer("s2:1"), listed) == {}
    assert _refused_by(answer("s1:1"), listed) == REFUSED
    # A moved member has an address that no supernode lists. So a supernode at such an address may be the member itself.
    assert _refused_by(answer("s9:1"), listed) == REFUSED
