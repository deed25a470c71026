"""A removal that ends without an answer says whether its outcome is known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import grpc
import pytest

from stampede_rt.administration import removal
from stampede_rt.administration.running_cluster import Cluster
from stampede_rt.errors import NotLeader, StampedeError, Unavailable
from stampede_rt.status import DETAILS_KEY, encode_status, from_rpc_error
from stampede_rt.v1 import directory_service_pb2 as directory_pb

NO_LEADER = NotLeader("this supernode does not lead")
NO_QUORUM = Unavailable("no majority answers", reason="NO_QUORUM")
AMBIGUOUS = Unavailable("the leader changed during the change", reason="AMBIGUOUS")


class Failure(grpc.RpcError):
    """A failed call, as gRPC raises it. `error`: the error with which the supernode has answered."""

    def __init__(self, code: grpc.StatusCode, details: str, error: StampedeError | None = None) -> None:
        self._code, self._details = code, details
        self._trailers = () if error is None else ((DETAILS_KEY, encode_status(error)),)

    def code(self) -> grpc.StatusCode:
        return self._code

    def details(self) -> str:
        return self._details

    def trailing_metadata(self) -> Any:
        return self._trailers


grpc.Call.register(Failure)
REFUSED = Failure(grpc.StatusCode.UNAVAILABLE, "failed to connect: Connection refused")
BROKEN = Failure(grpc.StatusCode.UNAVAILABLE, "Socket closed")
LATE = Failure(grpc.StatusCode.DEADLINE_EXCEEDED, "Deadline Exceeded")


def answered(error: StampedeError) -> Failure:
    return Failure(grpc.StatusCode.UNAVAILABLE, error.message, error)


class Supernodes:
    """Three supernodes that answer every list and ping. A removal fails with the next error of `failures`.
    The last error repeats.
    """

    def __init__(self, failures: list[Failure]) -> None:
        self._failures = failures
        self.now = 0.0
        self.directory = SimpleNamespace(ListSupernodes="list", Ping="ping")
        self.metadata = SimpleNamespace(cluster_id="")

    def to(self, address: str) -> Any:
        return SimpleNamespace(
            directory=self.directory,
            stub=lambda _: SimpleNamespace(RemoveSupernode="remove"),
            call=self._call_at(address),
        )

    def _call_at(self, address: str) -> Any:
        def call(method: str, request: Any, timeout_s: float) -> Any:
            if method == "list":
                listed = directory_pb.ListSupernodesResponse()
                for name in ("s1", "s2", "s3"):
                    listed.supernodes.add(supernode_id=name).endpoint.target = f"{name}:1"
                return listed
            if method == "ping":
                return directory_pb.DirectoryServicePingResponse(supernode_id=address.partition(":")[0])
            self.now += 1.0
            failure = self._failures.pop(0) if len(self._failures) > 1 else self._failures[0]
            raise from_rpc_error(failure, address) from failure

        return call


def removed(failures: list[Failure], monkeypatch: pytest.MonkeyPatch) -> StampedeError:
    supernodes: Any = Supernodes(failures)
    clock = SimpleNamespace(monotonic=lambda: supernodes.now, sleep=lambda seconds: None)
    monkeypatch.setattr(removal, "time", clock)
    with pytest.raises(StampedeError) as caught:
        Cluster(supernodes, ["s1:1"]).remove("s3")
    return caught.value


@pytest.mark.parametrize("first", [answered(AMBIGUOUS), BROKEN, LATE])
def test_a_removal_that_may_be_in_the_log_is_reported_with_an_unknown_outcome(
    first: Failure, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = removed([first, answered(NO_LEADER)], monkeypatch)
    assert error.reason == "AMBIGUOUS"
    assert "it is unknown whether s3 is removed: no supernode leads" in error.message
    assert "stampede supernode status" in error.message


@pytest.mark.parametrize("first", [answered(NO_QUORUM), answered(NO_LEADER), REFUSED])
def test_a_removal_that_no_supernode_received_is_not_reported_with_an_unknown_outcome(
    first: Failure, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = removed([first, answered(NO_LEADER)], monkeypatch)
    assert error.message.startswith("no supernode leads")
