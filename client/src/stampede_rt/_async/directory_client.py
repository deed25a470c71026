"""Calls to the directory. Front-ends name the supernodes. The client asks the nearest supernode, and then the next."""

from __future__ import annotations

import functools
import random
import time
from typing import Any, NamedTuple

from stampede_rt._async.endpoints import EndpointPool, connection_closed
from stampede_rt.cluster.binding import order_by_round_trip
from stampede_rt.cluster.cluster_ids import ClusterSeen, cluster_among, may_change_to, wrong_cluster
from stampede_rt.cluster.directory_call import (
    DirectoryCall,
    check_frontend,
    frontend_timeout_s,
    leader_hint,
    may_pass,
)
from stampede_rt.cluster.majority import UNREACHED
from stampede_rt.cluster.request_age import age_clock_s
from stampede_rt.errors import DeadlineExceeded, NotLeader, StampedeError, Unavailable, WrongCluster
from stampede_rt.pacing.retry import Backoff
from stampede_rt.security.tls_diagnosis import explain_refusal
from stampede_rt.transports.concurrency_async import in_thread, run_concurrently, sleep
from stampede_rt.transports.streams_async import ServerStream
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import frontend_service_pb2 as frontend_pb
from stampede_rt.values.peering import ClockOffset
from stampede_rt.version import PROTOCOL_VERSION, VERSION

MEASURE_EVERY_S = 60.0  # the average time between two measurements of the round trips
PING_TIMEOUT_S = 1.0
TRY_TIMEOUT_S = 2.5  # for one of several supernodes; if that supernode hangs, time is left for the others
CONNECT_TIMEOUT_S = 5.0
OTHERS_TIMEOUT_S = 0.5  # for front-ends that the client asks only for their cluster
EXPLAIN_TIMEOUT_S = 1.0  # the search for a certificate that explains a failure ends after this time
LEADERS_ASKED_MAX = 3  # for one call: the last known leader, the leader that this supernode names, and one more


class _Call(NamedTuple):
    """A call that the client may repeat.

    `since_s`: when the client first made this call, or an earlier call with the same request id (see `age_clock_s`).
    """

    method: str
    request: Any
    since_s: float


class _Pong(NamedTuple):
    """A supernode's answer to a ping. `clock`: this machine's clock offset; None if the supernode cannot serve."""

    cluster: ClusterSeen
    clock: ClockOffset | None


class DirectoryClient:
    """Calls the directory through the nearest supernode that is alive (paper, section 4.3)."""

    def __init__(self, frontends: tuple[str, ...], endpoints: EndpointPool, *, peer_name: str, zone: str) -> None:
        self._frontends = frontends
        self._endpoints = endpoints
        self.peer_name = peer_name
        self._zone = zone
        self._targets: list[str] = []
        self._in_other_zones: frozenset[str] = frozenset()  # supernodes of other zones, if this client has a zone
        self._measure_again_s = float("-inf")
        self._leader = ""  # the last known leader
        self._strangers: set[str] = set()  # addresses at which another cluster answers
        self.clock: ClockOffset | None = None  # measured by the last call whose answer had a supernode's time

    async def bind(self, timeout_s: float) -> None:
        """Ask one front-end after the other for the supernodes, and put the nearest first.

        At the first call, all front-ends that answer soon must be of one cluster. From then on the client belongs to
        that cluster. Raises Unavailable, PermissionDenied, VersionMismatch or WrongCluster if no front-end names
        supernodes within `timeout_s`.
        """
        deadline_s = time.monotonic() + timeout_s
        failure: StampedeError | None = None
        for position, target in enumerate(self._frontends):
            timeout_s = frontend_timeout_s(deadline_s - time.monotonic(), len(self._frontends) - position)
            try:
                response = await self._ask(target, timeout_s)
                self._check_cluster(target, response)
            except StampedeError as error:
                failure = error
                continue
            if not self.cluster_id:
                await self._check_others(response.cluster_id, target, self._frontends[position + 1 :])
            endpoints = [record.endpoint for record in response.supernodes]
            self._targets = [endpoint.target for endpoint in endpoints]
            if self._zone:
                others = [endpoint for endpoint in endpoints if endpoint.zone != self._zone]
                self._in_other_zones = frozenset(endpoint.target for endpoint in others)
            self._set_cluster(response.cluster_id)
            await self._measure()
            return
        raise await self._unbound(failure)

    @property
    def cluster_id(self) -> str:
        """The id of the client's cluster, which every call names. Empty as long as the client knows none."""
        return self._endpoints.metadata.cluster_id

    def _set_cluster(self, cluster_id: str) -> None:
        """Name this cluster in all later calls. Does nothing if the id is empty."""
        if cluster_id not in ("", self.cluster_id):
            self._endpoints.metadata.cluster_id = cluster_id

    def _check_cluster(self, target: str, response: frontend_pb.BindResponse) -> None:
        if not may_change_to(self.cluster_id, response.cluster_id, response.former_cluster_ids):
            raise wrong_cluster(f"the front-end {target}", response.cluster_id, self.cluster_id)

    async def _check_others(self, cluster_id: str, target: str, others: tuple[str, ...]) -> None:
        """Raise WrongCluster if one of `others` is of another cluster, and answers within OTHERS_TIMEOUT_S."""
        found = await run_concurrently([functools.partial(self._cluster_of, other) for other in others])
        for other, its_id in zip(others, found, strict=True):
            if cluster_id and its_id not in ("", cluster_id):
                raise WrongCluster(
                    f"the front-ends {target} and {other} are of different clusters, {cluster_id} and {its_id}; "
                    "name front-ends of one cluster in connect() or $STAMPEDE_URL",
                    metadata={"cluster_id": its_id},
                )

    async def _ask(self, target: str, timeout_s: float) -> frontend_pb.BindResponse:
        endpoint = self._endpoints.to(target)
        request = frontend_pb.BindRequest(
            peer_name=self.peer_name, zone=self._zone, protocol_version=PROTOCOL_VERSION, version=VERSION
        )
        response: frontend_pb.BindResponse = await endpoint.call(endpoint.frontend.Bind, request, timeout_s)
        check_frontend(target, response.protocol_version, response.version, caller="client", caller_version=VERSION)
        return response

    async def _cluster_of(self, frontend: str) -> str:
        """Return the cluster id of a front-end; empty if the front-end does not answer within OTHERS_TIMEOUT_S."""
        try:
            return (await self._ask(frontend, OTHERS_TIMEOUT_S)).cluster_id
        except StampedeError:
            return ""

    async def _unbound(self, failure: StampedeError | None) -> StampedeError:
        if isinstance(failure, Unavailable):
            failure = failure if isinstance(failure, WrongCluster) else await self._explain() or failure
        if failure is not None and not isinstance(failure, Unavailable | DeadlineExceeded):
            return failure
        if isinstance(failure, WrongCluster):
            return failure
        addresses = ", ".join(self._frontends)
        if isinstance(failure, Unavailable) and UNREACHED not in failure.metadata:
            return Unavailable(f"the front-end {addresses} runs, but cannot serve: {failure}", reason=failure.reason)
        return Unavailable(
            f"cannot connect to {addresses}: {failure} (start a cluster with `stampede dev`, or name another front-end "
            "in connect() or $STAMPEDE_URL)",
            reason=failure.reason if failure else "NO_QUORUM",
        )

    async def _explain(self) -> StampedeError | None:
        """Return an error that names the wrong certificate; None if no certificate explains the failure."""
        deadline_s = time.monotonic() + EXPLAIN_TIMEOUT_S
        for target in self._frontends:
            if time.monotonic() > deadline_s:
                break
            found = await in_thread(functools.partial(explain_refusal, target, self._endpoints.credentials.tls))
            if found is not None:
                return found
        return None

    async def _measure(self) -> None:
        """Ping all supernodes in parallel, and put the nearest first. Supernodes of the client's zone go before others.

        Supernodes that do not answer within PING_TIMEOUT_S go last. So do supernodes that cannot serve, and supernodes
        of another cluster, such as a restored backup at an old address. The time of the next ping is random, so that
        many clients do not ping at the same time.
        """
        self._measure_again_s = time.monotonic() + MEASURE_EVERY_S * (0.5 + random.random())
        targets = list(self._targets)
        pongs = await run_concurrently([functools.partial(self._ping, target) for target in targets])
        answered = {target: pong for target, pong in zip(targets, pongs, strict=True) if pong is not None}
        self._set_cluster(cluster_among(self.cluster_id, [pong.cluster for pong in answered.values()]))
        self._strangers = {
            target for target, pong in answered.items() if pong.cluster.cluster_id not in ("", self.cluster_id)
        }
        clocks = {
            target: pong.clock for target, pong in answered.items() if pong.clock and target not in self._strangers
        }
        round_trips_s = {target: 2e-9 * clock.uncertainty_nanos for target, clock in clocks.items()}
        self._targets = order_by_round_trip(self._targets, round_trips_s, self._in_other_zones)
        if self._targets:
            self.clock = clocks.get(self._targets[0], self.clock)

    async def _ping(self, target: str) -> _Pong | None:
        """Ask a supernode for its cluster and its clock; None if it does not answer."""
        began, sent = (
            time.monotonic_ns(),
            time.time_ns(),
            # The monotonic clock is first: a pause between the two readings then makes the round trip longer, not
            # shorter.
        )
        try:
            endpoint = self._endpoints.to(target)
            pong = await endpoint.call(
                endpoint.directory.Ping, directory_pb.DirectoryServicePingRequest(), PING_TIMEOUT_S
            )
        except StampedeError:
            return None
        took = time.monotonic_ns() - began
        clock = ClockOffset.measured(
            sent_unix_nano=sent, took_nanos=took, told_unix_nano=pong.time_unix_nano, supernode=pong.supernode_id
        )
        return _Pong(ClusterSeen(pong.cluster_id, tuple(pong.former_cluster_ids)), clock if pong.ready else None)

    async def call(self, method: str, request: Any, timeout_s: float, *, since_s: float | None = None) -> Any:
        """Make one call to the directory.

        If a supernode cannot serve, the client asks the next one. If none can, it asks the front-ends for other
        supernodes. Updates are safe to repeat: they carry a request id and their age. The age counts from now, or from
        `since_s` on the clock `age_clock_s`. Raises the directory's error, or Unavailable after `timeout_s`.
        """
        backoff = Backoff(time.monotonic() + timeout_s)
        call = _Call(method, request, age_clock_s() if since_s is None else since_s)
        rounds = DirectoryCall(backoff.deadline_s)
        while True:
            try:
                return await self._call_each(call, rounds)
            except StampedeError as error:
                if not may_pass(error):
                    raise
                if self._endpoints.closed:
                    raise
                delay_s = backoff.next_delay_s(time.monotonic(), random.random())
                if delay_s is None:
                    raise
                await sleep(delay_s)
            await self._rebind(backoff.deadline_s)

    async def _call_each(self, call: _Call, rounds: DirectoryCall) -> Any:
        """Ask one supernode after the other. If all fail, raises one error that sums up all failures so far."""
        if time.monotonic() > self._measure_again_s:
            await self._measure()
        supernodes = self._usable_targets()
        rounds.begin_round(supernodes, TRY_TIMEOUT_S if len(supernodes) > 1 else float("inf"))
        while (attempt := rounds.next_attempt(time.monotonic())) is not None:
            endpoint = self._endpoints.to(attempt.target)
            try:
                method = getattr(endpoint.directory, call.method)
                return await endpoint.call(method, call.request, attempt.timeout_s, age_s=age_clock_s() - call.since_s)
            except StampedeError as error:
                rounds.note_failure(attempt.target, error)
                self.demote(attempt.target, error)
        for target in self._strangers.difference(supernodes):
            rounds.note_failure(target, WrongCluster(f"{target} is of another cluster"))
        raise rounds.failure(self._targets)

    def _usable_targets(self) -> list[str]:
        """Return the supernodes to ask, best first: the supernodes of this cluster, or all if all are of another
        cluster."""
        return [target for target in self._targets if target not in self._strangers] or list(self._targets)

    def demote(self, target: str, error: StampedeError) -> None:
        """Put the supernode at `target` last, because it failed with `error`.

        If the supernode is of another cluster, the client asks it again only if it knows no supernode of its own
        cluster.
        """
        if target in self._targets:
            self._targets.remove(target)
            self._targets.append(target)
        if isinstance(error, WrongCluster):
            self._strangers.add(target)

    async def _rebind(self, deadline_s: float) -> None:
        """Ask the front-ends for other supernodes, because all known supernodes failed.

        If no front-end answers, the client keeps the supernodes that it knows, and pings them before the next round.
        """
        left_s = deadline_s - time.monotonic()
        try:
            await self.bind(max(min(left_s, CONNECT_TIMEOUT_S), 0.1))
        except (Unavailable, DeadlineExceeded):
            self._measure_again_s = float("-inf")

    async def present_cluster(self, deadline_s: float) -> str:
        """Return the id of the client's cluster. The id is a new one if the directory has begun anew.

        Raises Unavailable if no supernode of that cluster answers.
        """
        backoff = Backoff(min(deadline_s, time.monotonic() + CONNECT_TIMEOUT_S))
        while not await self._find_cluster():
            delay_s = backoff.next_delay_s(time.monotonic(), random.random())
            if self._endpoints.closed:
                raise connection_closed()
            if delay_s is None:
                raise Unavailable("no supernode answers, or the directory has just begun; try again")
            await sleep(delay_s)
            await self._rebind(backoff.deadline_s)
        return self.cluster_id

    async def _find_cluster(self) -> bool:
        """Whether a supernode of the client's cluster answers, or a supernode of a cluster that took over from it."""
        seen: list[ClusterSeen] = []
        for target in self._usable_targets():
            pong = await self._ping(target)
            if pong is not None and pong.cluster.cluster_id:
                seen.append(pong.cluster)
                if pong.cluster.cluster_id == self.cluster_id:
                    return True
        self._set_cluster(cluster_among(self.cluster_id, seen))
        return any(one.cluster_id == self.cluster_id for one in seen)

    async def call_leader(self, method: str, request: Any, timeout_s: float) -> Any:
        """Make one call that only the leader can answer.

        If the asked supernode does not lead, asks another supernode. Does not repeat the call after any other error.
        Raises the error of the call, and Unavailable if there is no leader. `timeout_s` holds for each request.
        """
        for _ in range(LEADERS_ASKED_MAX):
            self._leader = target = self._leader or await self._find_leader(timeout_s)
            endpoint = self._endpoints.to(target)
            try:
                return await endpoint.call(getattr(endpoint.directory, method), request, timeout_s)
            except NotLeader as error:
                self._leader = leader_hint(error)
            except WrongCluster as error:
                self.demote(target, error)
                self._leader = ""
            except (Unavailable, DeadlineExceeded):
                self._leader = ""
                raise
        raise Unavailable("the supernodes have no leader at present; try again, or run `stampede doctor`")

    async def _find_leader(self, timeout_s: float) -> str:
        response = await self.call("ListSupernodes", directory_pb.ListSupernodesRequest(), timeout_s)
        for record in response.supernodes:
            if record.is_leader:
                return str(record.endpoint.target)
        raise Unavailable("the supernodes have no leader at present; try again, or run `stampede doctor`")

    def stream(self, method: str, request: Any) -> ServerStream[Any]:
        """Open a stream of responses from the nearest supernode."""
        if not self._targets:
            raise Unavailable("no supernode is known; is a front-end running?")
        endpoint = self._endpoints.to(self._usable_targets()[0])
        return endpoint.stream(getattr(endpoint.directory, method), request)
