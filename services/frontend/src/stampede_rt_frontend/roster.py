"""The supernodes of a front-end: first the configured seeds, then the directory's own member list. Pure.

Values come in (the answers to probes), values go out (the supernodes to probe, and the supernodes to name to callers).
Nothing here is durable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from stampede_rt.cluster.cluster_ids import may_change_to
from stampede_rt.values.peering import ClockOffset
from stampede_rt_frontend.ranking import Supernode, smooth

SUPERNODES_MAX = 64  # probed at the same time; a cluster has at most 9 members


@dataclass(frozen=True, kw_only=True, slots=True)
class ProbeAnswer:
    """The answer of one supernode to a probe. `ready`: it can serve.

    `round_trip_nanos` is None if the probe had to make the connection first. `access_version`: the version of the
    supernode's access state. `clock`: how far this front-end's clock is ahead of the supernode's.
    """

    supernode_id: str
    cluster_id: str
    ready: bool
    round_trip_nanos: int | None
    former_cluster_ids: tuple[str, ...] = ()
    access_version: int = 0
    clock: ClockOffset | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class MemberList:
    """The members of the cluster, as one supernode lists them. The list with the highest (term, applied index) is the
    newest.
    """

    term: int
    applied_index: int
    members: tuple[Supernode, ...]


@dataclass(slots=True)
class SupernodeRoster:
    """The supernodes that this front-end knows, by target.

    Invariant: `_nodes` holds the seeds and the listed members, in this order, but no more than SUPERNODES_MAX.
    """

    seeds: tuple[str, ...]
    cluster_id: str = ""
    former_cluster_ids: tuple[str, ...] = ()  # this cluster has replaced these clusters
    clocks: dict[str, ClockOffset] = field(init=False, default_factory=dict)
    """How far this front-end's clock is ahead of the clock of each supernode that answers, by target."""
    _nodes: dict[str, Supernode] = field(init=False)
    _failures: dict[str, str] = field(init=False, default_factory=dict)  # target -> why its last probe failed
    _listed: dict[str, str] = field(init=False, default_factory=dict)  # the members of the last list: target -> id
    _position: tuple[int, int] = field(init=False, default=(0, 0))  # the (term, applied index) of the last list

    def __post_init__(self) -> None:
        if not 0 < len(self.seeds) <= SUPERNODES_MAX:
            raise ValueError(f"--supernodes must name 1 to {SUPERNODES_MAX} supernodes, each as HOST:PORT")
        self._nodes = {seed: Supernode(supernode_id="", target=seed) for seed in self.seeds}

    def targets(self) -> tuple[str, ...]:
        """The supernodes to probe."""
        return tuple(self._nodes)

    def note_answer(self, target: str, answer: ProbeAnswer) -> bool:
        """Process an answer of `target`. Returns False if the supernode belongs to another cluster and is left out."""
        node = self._nodes.get(target)
        if node is None:
            return True  # the supernode left the member list while its answer was on the way
        if not self._same_cluster(answer):
            self._fail(
                node,
                f"belongs to another cluster, {answer.cluster_id}, and this front-end serves {self.cluster_id}; if "
                f"{self.cluster_id} is permanently lost, start the front-end again",
            )
            return False
        measured = answer.round_trip_nanos
        trip = node.round_trip_nanos if measured is None else smooth(node.round_trip_nanos, measured)
        self._failures.pop(target, None)
        if answer.clock is not None:
            self.clocks[target] = answer.clock
        self._nodes[target] = replace(
            node, supernode_id=answer.supernode_id, has_answered=True, healthy=answer.ready, round_trip_nanos=trip
        )
        return True

    def note_failure(self, target: str, why: str) -> None:
        """Note that `target` did not answer, and the reason."""
        if target in self._nodes:
            self._fail(self._nodes[target], why)

    def update_members(self, members: MemberList) -> None:
        """Replace the known members by those of a list, unless this front-end knows a newer list. The seeds stay."""
        self._note_zones(members)
        position = (members.term, members.applied_index)
        if position < self._position or not members.members:
            return
        self._position = position
        reported = {one.target: one for one in members.members}
        self._listed = {one.target: one.supernode_id for one in members.members}
        wanted = [*self.seeds, *(target for target in reported if target not in self.seeds)][:SUPERNODES_MAX]
        self._nodes = {target: self._merged(target, reported.get(target)) for target in wanted}
        self.clocks = {target: clock for target, clock in self.clocks.items() if target in self._nodes}

    def _note_zones(self, members: MemberList) -> None:
        """Note the zones in a member list, even if the list is old.

        Each supernode lists only its own zone, so an old list has no wrong zone.
        """
        for one in members.members:
            if one.zone and one.target in self._nodes:
                self._nodes[one.target] = replace(self._nodes[one.target], zone=one.zone)

    def supernodes(self) -> list[Supernode]:
        """The supernodes to name to callers, each id once. Leaves out seeds that are not members.

        If several targets have the same id, names one that answered; among equals, one that is in the member list.
        """
        best: dict[str, Supernode] = {}
        members = set(self._listed.values())
        for node in sorted(
            self._nodes.values(), key=lambda one: (not one.has_answered, one.target not in self._listed)
        ):
            if node.supernode_id and (not members or node.supernode_id in members):
                best.setdefault(node.supernode_id, node)
        return list(best.values())

    def states(self) -> dict[str, str | None]:
        """For each target the reason why it cannot serve, or None if it can.

        Leaves out targets that have neither answered nor failed yet.
        """
        states: dict[str, str | None] = {}
        for target, node in self._nodes.items():
            if node.has_answered or target in self._failures:
                unready = "it knows no leader with a majority"
                states[target] = None if node.healthy else unready if node.has_answered else self._failures[target]
        return states

    def round_trips(self) -> dict[str, int]:
        """The smoothed round trips in nanoseconds, by target."""
        return {one: node.round_trip_nanos for one, node in self._nodes.items() if node.round_trip_nanos is not None}

    def any_healthy(self) -> bool:
        """Whether at least one supernode says that it can serve."""
        return any(node.healthy for node in self._nodes.values())

    def any_answered(self) -> bool:
        """Whether at least one supernode answered its last probe."""
        return any(node.has_answered for node in self._nodes.values())

    def failures(self) -> Sequence[str]:
        """The targets whose last probe failed, each with the reason, for error texts."""
        return [why if target in why else f"{target}: {why}" for target, why in self._failures.items()]

    def _same_cluster(self, answer: ProbeAnswer) -> bool:
        if not answer.cluster_id:
            return True
        if answer.cluster_id == self.cluster_id:
            self.former_cluster_ids = answer.former_cluster_ids or self.former_cluster_ids
            return True
        if self.cluster_id and self.any_healthy():
            return False
        if not may_change_to(self.cluster_id, answer.cluster_id, answer.former_cluster_ids):
            return False  # the cluster that this front-end serves may come back
        # This is the first cluster that answers, or it replaces the served cluster, which is gone.
        self.cluster_id, self._position = answer.cluster_id, (0, 0)
        self.former_cluster_ids = answer.former_cluster_ids
        self._listed = {}
        return True

    def _fail(self, node: Supernode, why: str) -> None:
        self._failures[node.target] = why
        self.clocks.pop(node.target, None)
        self._nodes[node.target] = replace(node, has_answered=False, healthy=False, is_leader=False)

    def _merged(self, target: str, reported: Supernode | None) -> Supernode:
        """The supernode at `target` with the data of a member list, `reported`; None: the list does not name it.

        Keeps the results of probes, and the zone if the list has none.
        """
        node = self._nodes.get(target) or Supernode(supernode_id="", target=target)
        if reported is None:
            return replace(node, is_leader=False)
        zone = reported.zone or node.zone
        return replace(node, supernode_id=reported.supernode_id, zone=zone, is_leader=reported.is_leader)
