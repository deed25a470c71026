"""Asks each part of a running cluster how much callers use of their quotas."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from stampede_rt._sync.endpoints import EndpointPool
from stampede_rt.administration.in_force import CALL_SECONDS, EnforcingPart
from stampede_rt.errors import StampedeError
from stampede_rt.v1 import quota_use_service_pb2 as pb
from stampede_rt.v1 import quota_use_service_pb2_grpc


class PartUse(NamedTuple):
    """The use of quotas at one part of the cluster. `failure` says why the part did not answer; empty if it did."""

    part: str
    uses: tuple[Any, ...] = ()
    failure: str = ""


def uses_at(endpoints: EndpointPool, parts: Iterable[EnforcingPart], subject_glob: str) -> Iterator[PartUse]:
    """Ask each part how much the callers that match `subject_glob` use. Yields one PartUse for each part."""
    request = pb.ListQuotaUseRequest(subject_glob=subject_glob)
    for part in parts:
        endpoint = endpoints.to(part.target)
        stub: Any = endpoint.stub(quota_use_service_pb2_grpc.QuotaUseServiceStub)
        try:
            response = endpoint.call(stub.ListQuotaUse, request, CALL_SECONDS)
        except StampedeError as error:
            yield PartUse(part.name, failure=error.message)
        else:
            yield PartUse(part.name, tuple(response.uses))
