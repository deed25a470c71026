"""Asks every part of a cluster for its state: front-ends, then the supernodes that they name, then the hosts.

The command cannot ask peers. Instead the leader of the supernodes passes on the facts that peers told it.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

from stampede_rt._sync.endpoints import EndpointPool
from stampede_rt.cli.asked_parts import AskedPart, PartAnswer, frontend_part, gatekeeper_of, host_part, supernode_part
from stampede_rt.cli.observations import CALLER, FRONTEND, HOST, PEER, SUPERNODE, Inventory, Observation
from stampede_rt.cli.supernode_findings import gathered
from stampede_rt.cluster.cluster_ids import IN_MEMORY
from stampede_rt.errors import PermissionDenied, StampedeError, Unavailable
from stampede_rt.security.tls_diagnosis import (
    Validity,
    certificate_validity,
    check_own_certificate,
    explain_refusal,
    validity_of,
)
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt.wire.records import policy_from_spec

TIMEOUT_S = 5.0  # for one request; a front-end may need 2 s of it to find a healthy supernode
ASKED_IN_PARALLEL_MAX = 16  # parts that the command asks in parallel
PATIENT_NANOS_MAX = 10**9  # if the first round trip takes longer, the command sends no second request
PAGES_MAX = 10_000  # the pages of one list


class Examination:
    """One examination of a cluster. The caller closes `endpoints` afterwards."""

    def __init__(self, endpoints: EndpointPool) -> None:
        self._endpoints = endpoints
        self._pool = ThreadPoolExecutor(ASKED_IN_PARALLEL_MAX)

    def look(self, frontends: Sequence[str], members: Sequence[str]) -> tuple[list[Observation], list[Inventory]]:
        """Ask the front-ends, the supernodes at `members`, and all parts that they name.

        Returns an observation of each part, and the inventories of channels and queues. Each request blocks for at most
        TIMEOUT_S. At most ASKED_IN_PARALLEL_MAX requests are under way at the same time.
        """
        with self._pool:
            bound = self._ask(map(frontend_part, frontends))
            named = dict.fromkeys(members, "")
            for answer in bound:
                if answer.response is not None:
                    named |= {record.endpoint.target: record.supernode_id for record in answer.response.supernodes}
            supernodes = self._supernodes(named)
            hosts = self._hosts(supernodes)
            by_name = {answer.seen.name: answer.seen for answer in supernodes}
            peers = [_peer(record, by_name) for record in self._peers(supernodes)]
            held = self._held(supernodes)
        return [*self._own(), *(answer.seen for answer in (*bound, *supernodes, *hosts)), *peers], held

    def _held(self, supernodes: Sequence[PartAnswer]) -> list[Inventory]:
        """Return the inventories of channels and queues. An inventory is missing if no supernode gives it."""
        channels = directory_pb.ListChannelsRequest(stale_ok=True)
        queues = queue_directory_pb.ListQueuesRequest(stale_ok=True, include_mailboxes=True)
        channel_pages = self._pages(supernodes, "ListChannels", channels)
        queue_pages = self._pages(supernodes, "ListQueues", queues)
        found = [_holdings("channel", "channels", channel_pages), _holdings("queue", "queues", queue_pages)]
        is_partial = any(one.seen.limits_caller for one in supernodes)
        return [replace(one, is_partial=is_partial) for one in found if one is not None]

    def _pages(self, supernodes: Sequence[PartAnswer], method: str, request: Any) -> Iterator[Any]:
        """Yield the pages of a listing, or None for a page that no supernode gives."""
        for _ in range(PAGES_MAX):
            page = self._first(supernodes, method, request)
            yield page
            if page is None or not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def _supernodes(self, named: dict[str, str]) -> list[PartAnswer]:
        """Ask the named supernodes, and the members that the first of them lists. A list needs no majority."""
        first = self._ask(supernode_part(name, address) for address, name in named.items())
        own_id = _cluster_of_most(first)
        ready_first = sorted((one for one in first if not _of_others(one, own_id)), key=lambda one: not one.seen.ready)
        listed = {record.endpoint.target: record.supernode_id for record in self._listed(ready_first)}
        found = {one.response.supernode_id for one in first if one.response is not None}
        rest = {address: name for address, name in listed.items() if address not in named and name not in found}
        more = self._ask(supernode_part(name, address) for address, name in rest.items())
        refused = gathered(_refused_by(one, listed) for one in (*first, *more) if not _of_others(one, own_id))
        answers = [_named(_marked_if_foreign(one, own_id), listed, refused) for one in (*first, *more)]
        return sorted(answers, key=lambda one: one.seen.name)

    def _listed(self, answers: Iterable[PartAnswer]) -> Sequence[Any]:
        response = self._first(answers, "ListSupernodes", directory_pb.ListSupernodesRequest())
        return response.supernodes if response else ()

    def _hosts(self, supernodes: Iterable[PartAnswer]) -> list[PartAnswer]:
        response = self._first(supernodes, "ListHosts", directory_pb.ListHostsRequest(include_dead=True, stale_ok=True))
        hosts = response.hosts if response else ()
        alive = [host for host in hosts if host.alive]
        lost = [_lost(one) for one in hosts if not one.alive]
        answers = self._ask(map(host_part, alive))
        return [*map(_with_load, answers, alive), *(PartAnswer(None, one) for one in lost)]

    def _peers(self, supernodes: Sequence[PartAnswer]) -> Iterator[Any]:
        """Yield the records of live peers. If there is a leader, they have the clock offsets that the peers told it."""
        request = peer_pb.ListPeersRequest(stale_ok=True, with_clocks=True)
        for _ in range(PAGES_MAX):
            page = self._first(supernodes, "ListPeers", request)
            if page is None:
                request.with_clocks = False
                page = self._first(supernodes, "ListPeers", request)
            if page is None:
                return
            yield from page.peers
            if not page.next_page_token:
                return
            request.page_token = page.next_page_token

    def _first(self, supernodes: Iterable[PartAnswer], method: str, request: Any) -> Any:
        """Return the answer of the first supernode that answers `request`; None if no supernode answers."""
        for one in supernodes:
            if one.response is not None:
                endpoint = self._endpoints.to(one.seen.address)
                try:
                    return endpoint.call(getattr(endpoint.directory, method), request, TIMEOUT_S)
                except StampedeError:
                    continue  # the next supernode may answer
        return None

    def _ask(self, parts: Iterable[AskedPart]) -> list[PartAnswer]:
        return list(self._pool.map(self._probe, parts))

    def _probe(self, part: AskedPart) -> PartAnswer:
        """Ask one part. Returns its response, or None if the call failed, and the observation."""
        seen = Observation(kind=part.kind, name=part.name, address=part.address)
        tls = self._endpoints.credentials.tls
        try:
            response, sent, round_trip = self._timed(part)
        except StampedeError as error:
            refused = explain_refusal(part.address, tls) if isinstance(error, Unavailable) else None
            failure = refused or error
            knows = part.kind != FRONTEND or not _is_own_answer(error)
            is_refused = isinstance(failure, PermissionDenied)
            return PartAnswer(
                None, replace(seen, failure=failure.message, knows_supernodes=knows, refuses_caller=is_refused)
            )
        validity = certificate_validity(part.address, tls) if tls else None
        return PartAnswer(
            response,
            replace(
                seen,
                ready=getattr(response, "ready", True),
                lease_held=getattr(response, "lease_held", True),
                **(_load(response) if part.kind == HOST else {}),
                **(_levels(response) if part.kind == SUPERNODE else {}),
                in_memory=part.kind == SUPERNODE and response.cluster_id.startswith(IN_MEMORY),
                denials=response.access.denials,
                denied_ago_nanos=_optional(response.access, "denied_ago_nanos"),
                quota_refusals=response.access.quota_refusals,
                quota_refused_ago_nanos=_optional(response.access, "quota_refused_ago_nanos"),
                limits_caller=response.access.limits_caller,
                round_trip_nanos=round_trip,
                clock_offset_nanos=response.time_unix_nano - (sent + round_trip // 2),
                version=response.version,
                **_certificate(validity),
            ),
        )

    def _timed(self, part: AskedPart) -> tuple[Any, int, int]:
        """Return the response, the time of the request by the wall clock, and the round trip. Raises StampedeError."""
        endpoint = self._endpoints.to(part.address)
        method = getattr(getattr(endpoint, part.service), part.method)
        for is_last in (False, True):
            # Read the monotonic clock first. A pause between the two readings then makes the round trip longer,
            # and so shows in the uncertainty of the clock offset.
            started, sent = time.monotonic_ns(), time.time_ns()
            response = endpoint.call(method, part.request, TIMEOUT_S)
            round_trip = time.monotonic_ns() - started
            # The first call also opens the connection, so it takes longer. If it was very slow, a second call would not
            # help.
            if is_last or round_trip > PATIENT_NANOS_MAX:
                break
        return response, sent, round_trip

    def _own(self) -> list[Observation]:
        """Return an observation of the caller's own certificate; an empty list if the caller has no certificate."""
        tls = self._endpoints.credentials.tls
        if tls is None:
            return []
        seen = Observation(kind=CALLER, address=str(tls.files.certificate))
        try:
            validity = validity_of(check_own_certificate(tls))
        except PermissionDenied as error:
            return [replace(seen, failure=error.message)]
        return [replace(seen, **_certificate(validity))]


def _certificate(validity: Validity | None) -> dict[str, Any]:
    """Return the fields of an observation that say how long a certificate is valid in all, and from now on."""
    if validity is None:
        return {}
    lasts_s = validity.ends_s - validity.begins_s
    return {"certificate_left_s": validity.ends_s - time.time(), "certificate_lasts_s": lasts_s}


def _is_own_answer(error: StampedeError) -> bool:
    """Whether the part itself answered that it is unavailable. If not, the call did not reach the part, or broke."""
    return error.from_service and isinstance(error, Unavailable)


def _with_load(answer: PartAnswer, host: Any) -> PartAnswer:
    """Return the answer of a host, with the load that the host has reported to the directory."""
    busy = host.load.busy_permille if host.HasField("load") else None
    return answer._replace(seen=replace(answer.seen, busy_permille=busy))


def _peer(record: Any, supernodes: Mapping[str, Observation]) -> Observation:
    """Return the observation of a peer.

    The peer has measured the offset of its clock from the clock of a supernode. If the caller knows how far this
    supernode's clock is ahead of its own, the sum of both offsets is the offset of the peer's clock.
    """
    seen = Observation(kind=PEER, name=record.name or record.peer_id.hex(), address="-", version=record.version)
    between = supernodes.get(record.clock.supernode_id) if record.HasField("clock") else None
    if between is None or between.round_trip_nanos is None or between.clock_offset_nanos is None:
        return seen
    return replace(
        seen,
        round_trip_nanos=between.round_trip_nanos + 2 * record.clock.uncertainty_nanos,
        clock_offset_nanos=between.clock_offset_nanos + record.clock.offset_nanos,
    )


def _lost(host: Any) -> Observation:
    ended = host.lease_ended_unix_nano if host.HasField("lease_ended_unix_nano") else None
    for_nanos = None if ended is None else max(0, time.time_ns() - ended)
    return Observation(kind=HOST, name=host.name, address=gatekeeper_of(host), alive=False, lost_for_nanos=for_nanos)


def _levels(response: Any) -> dict[str, Any]:
    """Return the fields of an observation for the feature levels of a supernode."""
    return {"feature_level": response.feature_level, "highest_feature_level": response.highest_feature_level}


def _load(response: Any) -> dict[str, Any]:
    """Return the fields of an observation for the memory and archive of a host, and for the refused calls."""
    return {
        "refused_items": response.refused_items,
        "refused_for_archive": response.refused_for_archive,
        "refused_ago_nanos": _optional(response, "refused_ago_nanos"),
        "held_bytes": response.held_bytes,
        "memory_bytes_max": response.memory_bytes_max,
        "refused_calls": response.refused_calls,
        "archive_failure": response.archive_failure,
        "archive_failing_channels": response.archive_failing_channels,
        "archive_store_failure": response.archive_store_failure,
        "refused_call_ago_nanos": _optional(response, "refused_call_ago_nanos"),
    }


def _optional(message: Any, field: str) -> Any:
    return getattr(message, field) if message.HasField(field) else None


def _holdings(kind: str, field: str, pages: Iterable[Any]) -> Inventory | None:
    """Count the channels or queues in `pages`. Returns None if a page is None, because no supernode gave that page."""
    count, lost, recorded = 0, list[tuple[str, str]](), list[tuple[str, str]]()
    for page in pages:
        if page is None:
            return None
        hosts = {host.host_id: host for host in page.hosts}
        count += len(getattr(page, field))
        for one in getattr(page, field):
            host = hosts.get(one.host_id)
            if host is not None and not host.alive:
                is_recorded = kind == "channel" and policy_from_spec(one.spec).is_recorded
                where = f" (archive: {host.archive_place})" if is_recorded and host.archive_place else ""
                holdings = recorded if is_recorded else lost
                holdings.append((one.name or "a mailbox", f"host {host.name}{where}"))
    return Inventory(kind=kind, count=count, lost=lost, recorded=recorded)


def _cluster_of_most(answers: Iterable[PartAnswer]) -> str:
    """Return the id of the cluster to which most of these supernodes belong; empty if no answer names a cluster."""
    counts = Counter(one.response.cluster_id for one in answers if one.response is not None and one.response.cluster_id)
    return counts.most_common(1)[0][0] if counts else ""


def _of_others(answer: PartAnswer, own_id: str) -> bool:
    """Whether a supernode says that its cluster is not `own_id`."""
    return bool(own_id) and answer.response is not None and answer.response.cluster_id not in ("", own_id)


def _marked_if_foreign(answer: PartAnswer, own_id: str) -> PartAnswer:
    """Return the answer. If the supernode is of another cluster than `own_id`, the observation says so as a failure."""
    if not _of_others(answer, own_id):
        return answer
    failure = (
        f"a supernode of another cluster, {answer.response.cluster_id}, answers there instead of one of {own_id}: stop "
        "that supernode, and start the member of this address, or remove the member from the cluster"
    )
    return answer._replace(seen=replace(answer.seen, failure=failure))


def _refused_by(answer: PartAnswer, listed: Mapping[str, str]) -> Mapping[str, str]:
    """Return the ids of the supernodes whose stores the answering supernode refuses, each with the reason.

    The mapping is empty if another supernode should answer at this address: the answer may come from a copied store.
    """
    if answer.response is None:
        return {}
    expected = listed.get(answer.seen.address, answer.response.supernode_id)
    return answer.response.refused_supernodes if answer.response.supernode_id == expected else {}


def _named(answer: PartAnswer, listed: dict[str, str], refused: Mapping[str, str]) -> PartAnswer:
    """Return the answer of a supernode with the facts that other supernodes tell about it.

    `listed` has the ids of the members by address, and `refused` the reasons why others refuse a supernode, by its id.
    """
    seen = answer.seen
    expected = listed.get(seen.address, "")
    supernode_id = answer.response.supernode_id if answer.response is not None else expected
    if expected and supernode_id != expected:
        failure = (
            f"another supernode, {supernode_id}, answers there; start the member of this address, {expected}, or "
            "remove that member from the cluster"
        )
        return answer._replace(seen=replace(seen, name=expected, failure=failure))
    name = supernode_id or seen.name
    is_member = not listed or name in listed.values()
    return answer._replace(seen=replace(seen, name=name, is_member=is_member, refused_because=refused.get(name, "")))
