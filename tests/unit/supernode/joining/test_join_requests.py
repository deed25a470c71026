"""A newcomer that the members refuse keeps a note, and does not ask again immediately, however often the process is
started.
"""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grpc
import pytest

from stampede_rt.errors import PermissionDenied, StampedeError, VersionMismatch
from stampede_rt.status import abort
from stampede_rt.v1 import membership_service_pb2 as pb
from stampede_rt.v1 import membership_service_pb2_grpc
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving
from stampede_rt_supernode.joining.founding import FoundingRecord, read_founding, write_founding
from stampede_rt_supernode.joining.join_requests import REFUSED_SECONDS_MAX, ask_to_join, seconds_before_asking
from stampede_rt_supernode.replication.interface import too_old


class Leader(membership_service_pb2_grpc.MembershipServiceServicer):
    """Refuses all newcomers until the test changes that. Then the newcomer is a member."""

    def __init__(self) -> None:
        self.refuses, self.calls, self.has_accepted = True, 0, False
        self.refusal: StampedeError = PermissionDenied("the token has expired", reason="UNAUTHENTICATED")
        self.log: Any = SimpleNamespace(status=lambda: SimpleNamespace(self_id="new", members=self._members()))

    def _members(self) -> list[Any]:
        return [SimpleNamespace(member_id="new")] if self.has_accepted else []

    async def AddSupernode(  # noqa: N802
        self, request: pb.AddSupernodeRequest, context: Any
    ) -> pb.AddSupernodeResponse:
        self.calls += 1
        if self.refuses:
            await abort(context, self.refusal)
        self.has_accepted = True
        return pb.AddSupernodeResponse()


async def started(leader: Leader, address: str, folder: Path) -> list[float]:
    """Start the newcomer as its folder says, as a supervisor does; returns for how long it waited."""
    waited: list[float] = []

    async def sleep(seconds: float) -> None:
        waited.append(seconds)

    def to(target: str) -> grpc.aio.Channel:
        return dial(target, secret=None)

    founding = read_founding(folder)
    assert founding is not None
    requests = leader.calls
    with (
        pytest.raises(StampedeError, match=f"cannot join: {leader.refusal.message}")
        if leader.refuses
        else nullcontext()
    ):
        await ask_to_join(founding, folder, leader.log, to, zone="", sleep=sleep)
    assert leader.calls == requests + 1
    return waited


async def test_a_refused_new_member_notes_the_refusal_and_tries_again_at_growing_intervals(tmp_path: Path) -> None:
    leader = Leader()
    register = membership_service_pb2_grpc.add_MembershipServiceServicer_to_server
    async with serving(lambda server: register(leader, server)) as server:
        founding = FoundingRecord(
            supernode_id="new", address="h:1", members={"a": server.address}, joining=True, token="t"
        )
        write_founding(tmp_path, founding)
        assert [await started(leader, server.address, tmp_path) for _ in range(5)] == [[], [1.0], [2.0], [4.0], [8.0]]
        noted = read_founding(tmp_path)
        assert noted is not None
        assert (noted.refusals, "the token has expired" in noted.refused, noted.token) == (5, True, "t")
        leader.refuses = False
        assert (await started(leader, server.address, tmp_path))[0] == 16.0
        joined = read_founding(tmp_path)
        assert joined is not None
        assert (joined.refusals, joined.refused, joined.token) == (0, "", "")


async def test_a_new_member_of_an_older_release_is_refused_and_joins_with_the_newer_release_and_the_same_folder(
    tmp_path: Path,
) -> None:
    leader = Leader()
    leader.refusal = VersionMismatch(too_old("new", 1, 2))
    register = membership_service_pb2_grpc.add_MembershipServiceServicer_to_server
    async with serving(lambda server: register(leader, server)) as server:
        founding = FoundingRecord(
            supernode_id="new", address="h:1", members={"a": server.address}, joining=True, token="t"
        )
        write_founding(tmp_path, founding)
        with pytest.raises(
            StampedeError, match="at level 2; start it with the release of the others and the same data"
        ):
            await ask_to_join(founding, tmp_path, leader.log, lambda target: dial(target, secret=None), zone="")
        leader.refuses = False
        await started(leader, server.address, tmp_path)


@pytest.mark.parametrize(("refusals", "seconds"), [(0, 0), (1, 1), (5, 16), (9, 256), (10, 300), (10**6, 300)])
def test_the_pause_doubles_up_to_a_bound(refusals: int, seconds: float) -> None:
    assert seconds_before_asking(refusals) == seconds <= REFUSED_SECONDS_MAX
