"""The findings about a cluster, from the answers of its parts, and what to do about each. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from stampede_rt.cli.output import bytes_text
from stampede_rt.values.timeline import format_duration

CLOCK_OFFSET_NANOS_MAX = 50_000_000
REFUSED_LATELY_NANOS = 600 * 10**9
NAMED_MAX = 5
UNKNOWN = "unknown"  # the clock of a peer that has not told its offset
STORE_ADVICE = (
    "start it with its latest data folder, or, if that is lost, remove it (stampede supernode remove) and "
    "let it join under a new id (runbook: replace one)"
)
# In the words of a supernode whose state is not that of most members.
DIVERGED = "differs from that of most members"
# In the words about a supernode whose state is not the leader's, while nobody knows the state of most members.
DOUBTFUL = "differs from that of the leader"
IN_DOUBT = "in doubt"
REFUSED_BY = " (says "  # follows each reason for which a supernode is refused
DOUBT_ADVICE = (
    "it goes on serving. Start the supernodes that are down, if any: then most may agree. Otherwise start this one and "
    "the leader again, one after the other, with their data folders: an error in memory alone is gone then. If the "
    "doubt stays, remove the one whose release or machine you trust less (stampede supernode remove), and let it join "
    "under a new id"
)
# In the words about a supernode whose release does not know the cluster's feature level.
TOO_OLD = "is of a release that is too old"
REPLACE_ADVICE = (
    "remove it (stampede supernode remove), empty its folder, and let it join under a new id (runbook: replace one)"
)
FRONTEND, SUPERNODE, HOST, PEER, CALLER = "front-end", "supernode", "host", "peer", "this caller"


def gathered(told: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """For each supernode, all the reasons that others give for refusing its store."""
    reasons: dict[str, dict[str, None]] = {}
    for one in told:
        for name, why in one.items():
            reasons.setdefault(name, {})[why] = None
    return {name: "; ".join(each) for name, each in reasons.items()}


def refusal(why: str) -> tuple[str, str]:
    """The state of a supernode that others refuse for `why`, or that refuses to serve; and what to do."""
    if DIVERGED in why:
        return "diverged", f"{why}; {REPLACE_ADVICE}"
    if DOUBTFUL in why and REFUSED_BY not in why:
        return IN_DOUBT, f"{why}; {DOUBT_ADVICE}"
    if TOO_OLD in why:
        return "release refused", f"{why}; start it with the release of the others and the same data folder"
    return "store refused", f"{why}; {STORE_ADVICE}"


def level_finding(level: int, highest: Mapping[str, int | None]) -> tuple[str, str]:
    """The feature level of a cluster, and what to do if supernodes keep it from rising.

    `highest`: for each supernode the highest level that its release knows; None: it has not told.
    """
    goal = max((known for known in highest.values() if known is not None), default=level)
    if goal <= level:
        return str(level), ""
    older = [name for name, known in sorted(highest.items()) if known is not None and known < goal]
    silent = [name for name, known in sorted(highest.items()) if known is None]
    steps = [f"upgrade {_joined(older)}"] if older else []
    steps += [f"start {_joined(silent)}, whose release is unknown"] if silent else []
    if not steps:
        return f"{level}, about to rise to {goal}", ""
    return (
        f"{level}, and not all know {goal}",
        f"{' and '.join(steps)}; the level then rises by itself (runbook: upgrade)",
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """One part's answer, or the reason why it gave none (`failure`).

    - `clock_offset_nanos`: its clock against the caller's, give or take half of the round trip.
    - `alive`: the directory's word about a host. `lease_held`: the host's own word.
    - `knows_supernodes`: of a front-end.
    - `lost_for_nanos`: the time since the directory ended the lease of a host that did not deregister.
    - `refused_items`: what a host refused as Overloaded since its start, the last one `refused_ago_nanos` ago;
      `refused_calls`: calls that it refused or ended so, the last one `refused_call_ago_nanos` ago.
    - `is_member`: whether the other supernodes list this one.
    - `refuses_caller`: it runs, but a secret or certificate, this caller's or its own, does not fit.
    - `refused_because`: why other supernodes refuse its store.

    A peer cannot be asked: it told the leader. Its round trip is the sum of the caller's and its own to the supernode
    between them.
    """

    kind: str
    address: str
    name: str = ""
    failure: str = ""
    ready: bool = True
    alive: bool = True
    lease_held: bool = True
    knows_supernodes: bool = True
    is_member: bool = True
    lost_for_nanos: int | None = None
    refused_items: int = 0
    refused_ago_nanos: int | None = None
    refused_calls: int = 0
    refused_call_ago_nanos: int | None = None
    held_bytes: int = 0
    memory_bytes_max: int = 0
    refuses_caller: bool = False
    refused_because: str = ""
    round_trip_nanos: int | None = None
    clock_offset_nanos: int | None = None
    version: str = ""
    # Of a supernode: the cluster's feature level as it knows it, and the highest of its release; 0: not told.
    feature_level: int = 0
    highest_feature_level: int = 0
    certificate_left_s: float | None = None

    @property
    def clock_doubt_nanos(self) -> int:
        """The greatest error of the clock offset: the way there may have taken all of the round trip, or none."""
        return (self.round_trip_nanos or 0) // 2

    @property
    def part(self) -> str:
        """Its name for people."""
        return f"{self.kind} {self.name}".strip()


@dataclass(frozen=True, kw_only=True, slots=True)
class Inventory:
    """The channels, or the queues, of the whole directory: their number, and the names and hosts of the lost ones."""

    kind: str
    count: int
    lost: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One finding. `advice` is empty if nothing is wrong."""

    part: str
    address: str
    state: str
    advice: str = ""
    seen: Observation | None = None


def diagnose(
    seen: Sequence[Observation], held: Sequence[Inventory] = (), *, own_version: str, certificate_s_min: float
) -> list[CheckResult]:
    """Return all findings: first each part, then what concerns them together."""
    parts = [_of_part(one, certificate_s_min) for one in seen]
    of_all = [*_frontends(seen), *_quorum(seen), *_hosts(seen), *map(_holdings, held), *_clocks(seen)]
    return [*parts, *of_all, *_versions(seen, own_version), *_levels(seen)]


def _of_part(one: Observation, certificate_s_min: float) -> CheckResult:
    state, advice = _state(one)
    left_s = one.certificate_left_s
    if not advice and left_s is not None and left_s < certificate_s_min:
        advice = f"its certificate ends in {left_s / 86400:.1f} days; issue it anew (stampede certs issue)"
        if left_s < 0:
            advice = "its certificate has expired; issue it anew (stampede certs issue)"
    return CheckResult(one.part, one.address, state, advice, one)


def _state(one: Observation) -> tuple[str, str]:
    if not one.alive:
        return _lost(one)
    if not one.knows_supernodes:
        return "no supernode", one.failure
    if not one.is_member:
        return "no member", "the supernodes do not list it: it was removed, or never joined; do not name it"
    if one.refused_because:
        return refusal(one.refused_because)
    if one.failure and one.kind == CALLER:
        return "not valid", one.failure
    if one.failure:
        return "refused" if one.refuses_caller else "unreachable", one.failure
    if not one.ready:
        return "no leader", "it runs, but knows no leader; see the line on the quorum"
    if not one.lease_held:
        return "fenced", "it cannot renew its lease; check the network between it and the supernodes"
    return _load(one)


def _lost(one: Observation) -> tuple[str, str]:
    if one.lost_for_nanos is None:
        advice = "it left, or came back without its data folder, but still owns channels or queues; open them again"
        return "gone", advice
    advice = "its lease has ended: it was killed, hangs, or is cut off from the network; start it again"
    return f"lost {_roughly(one.lost_for_nanos)} ago", advice


def _load(one: Observation) -> tuple[str, str]:
    """The state of a host that serves, against its memory bound and the number of its calls."""
    kinds = (
        (one.refused_items, "puts", one.refused_ago_nanos),
        (one.refused_calls, "calls", one.refused_call_ago_nanos),
    )
    refused = [(f"{count} {what}", ago) for count, what, ago in kinds if count]
    if not refused:
        return "ok", ""
    state = f"{' and '.join(text for text, _ in refused)} refused"
    advice = " ".join(filter(None, (_refused_puts(one), _refused_calls(one))))
    return (state, advice) if advice else (f"ok, {state} before", "")


def _refused_puts(one: Observation) -> str:
    """Advice, if it was lately."""
    if one.refused_ago_nanos is None or one.refused_ago_nanos > REFUSED_LATELY_NANOS:
        return ""
    return (
        f"it refused puts as Overloaded, the last one {_roughly(one.refused_ago_nanos)} ago; it holds "
        f"{bytes_text(one.held_bytes)} of {bytes_text(one.memory_bytes_max)}: raise --memory-bytes-max, tighten the "
        "retention of its channels, or start another host (`stampede ls -l` shows who holds what)"
    )


def _refused_calls(one: Observation) -> str:
    """Advice, if it was lately."""
    if one.refused_call_ago_nanos is None or one.refused_call_ago_nanos > REFUSED_LATELY_NANOS:
        return ""
    return (
        f"it refused or ended calls as Overloaded, the last one {_roughly(one.refused_call_ago_nanos)} ago, as its log "
        "says: too many streams, reads or channels at once, or a reader that took nothing; close some, or start "
        "another host"
    )


def _of(kind: str, seen: Sequence[Observation]) -> list[Observation]:
    return [one for one in seen if one.kind == kind]


def _frontends(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    frontends, supernodes = _of(FRONTEND, seen), _of(SUPERNODE, seen)
    answering = sum(not one.failure for one in frontends)
    if not frontends:
        return
    state, advice = f"{answering} of {len(frontends)} serve", ""
    if not any(one.knows_supernodes and not one.failure for one in frontends):
        known = ",".join(one.address for one in supernodes) or "HOST:PORT,..."
        look = "" if supernodes else "; to look at the supernodes, name one: stampede doctor --member HOST:PORT"
        advice = (
            "connected clients go on, but no new client can connect; start a front-end: "
            f"stampede frontend --supernodes {known}{look}"
        )
        if any(not one.knows_supernodes for one in frontends):
            advice = (
                "they run, but reach no supernode: no client can connect; start the supernodes with their data folders"
            )
        elif any(one.refuses_caller for one in frontends):
            state, advice = (
                "unknown",
                "they run, but refuse this caller; use the cluster's secret and certificates to see more",
            )
    yield CheckResult("front-ends", "-", state, advice)


def _quorum(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    members = [one for one in _of(SUPERNODE, seen) if one.is_member]
    if not members:
        return
    refused = sum(one.refuses_caller for one in members)
    down = _joined([one.name or one.address for one in members if one.failure and not one.refuses_caller])
    running, ready = [one for one in members if not one.failure], sum(one.ready and not one.failure for one in members)
    needed = len(members) // 2 + 1
    if ready >= needed:
        again = f"start {down} again with its data folder, or, if that is lost, replace it (runbook: replace one)"
        yield CheckResult("quorum", "-", f"{ready} of {len(members)} serve", again if down else "")
    elif len(running) >= needed:
        yield CheckResult(
            "quorum",
            "-",
            f"{len(running)} of {len(members)} run, {ready} serve",
            "a majority runs, but has no leader; look again in 5 s, then check the network between them",
        )
    elif len(running) + refused >= needed:
        advice = "a majority runs, but refuses this caller; use the cluster's secret and certificates to see more"
        yield CheckResult("quorum", "-", "unknown", advice)
    else:
        yield CheckResult(
            "quorum",
            "-",
            f"{len(running)} of {len(members)} run",
            f"the directory has no majority and refuses all changes ({needed} must run); start {down} with their "
            f"data folders, or, if those are lost, see the runbook: {_chapter(len(members), len(running))}. "
            "Hosts cannot renew their leases: within 5 s they refuse all calls. They keep their items, and serve them "
            "again when a majority serves again",
        )


def _chapter(members: int, running: int) -> str:
    return "lose all" if running == 0 else "lose two" if members == 3 else "restore"


def _hosts(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    if any(one.kind == SUPERNODE and one.ready and not one.failure for one in seen) and not _of(HOST, seen):
        yield CheckResult(HOST, "-", "none", "no channel host has registered; start one with `stampede host`")


def _holdings(held: Inventory) -> CheckResult:
    if not held.lost:
        return CheckResult(f"{held.kind}s", "-", f"{held.count}, none lost")
    names = [name for name, _ in held.lost[:NAMED_MAX]]
    more = f" and {len(held.lost) - NAMED_MAX} more" if len(held.lost) > NAMED_MAX else ""
    hosts = _joined(sorted({host for _, host in held.lost}))
    advice = (
        f"{', '.join(names)}{more} belonged to {hosts}, which is lost with its items; start it again, or open them at "
        f"another host: the next put into a {held.kind} does that"
    )
    return CheckResult(f"{held.kind}s", "-", f"{len(held.lost)} of {held.count} lost", advice)


def _clocks(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    """Find wrong clocks, against those of most services and the caller's.

    A slow answer tells little of a clock: an offset within half of its round trip counts as none.
    """
    offsets = {one: one.clock_offset_nanos for one in seen if one.clock_offset_nanos is not None}
    told = {one: offset for one, offset in offsets.items() if one.clock_doubt_nanos <= CLOCK_OFFSET_NANOS_MAX}
    services = [one for one in told if one.kind != PEER]
    if not services:
        if offsets:
            quickest = format_duration(2 * min(one.clock_doubt_nanos for one in offsets))
            yield CheckResult(
                "clocks", "-", f"{UNKNOWN}: answers took {quickest} or longer, too long to compare clocks"
            )
        return
    middle = sorted(offsets[one] for one in services)[(len(services) - 1) // 2]
    doubt = max(one.clock_doubt_nanos for one in services)
    off = {
        one: offset - middle
        for one, offset in offsets.items()
        if is_off(offset - middle, doubt + one.clock_doubt_nanos)
    }
    advice = [f"the clock of {one.part} is {ahead(nanos)} the others'; synchronise it" for one, nanos in off.items()]
    if is_off(middle, 2 * doubt):
        advice.append(f"this machine's clock is {ahead(-middle)} the cluster's; synchronise this machine's")
    yield CheckResult(
        "clocks",
        "-",
        _apart(told | {one: offsets[one] for one in off}),
        f"{'; '.join(advice)} (chrony, ntpd)" if advice else "",
    )


def _apart(offsets: Mapping[Observation, int]) -> str:
    """How far the clocks are apart, the caller's included, and how well that is known."""
    known = [(offset, one.clock_doubt_nanos) for one, offset in offsets.items()] + [(0, 0)]
    (high, high_doubt), (low, low_doubt) = max(known), min(known, key=lambda one: (one[0], -one[1]))
    return (
        f"{_roughly(high - low)} apart, give or take {_roughly(high_doubt + low_doubt)}, "
        f"{format_duration(CLOCK_OFFSET_NANOS_MAX)} are allowed"
    )


def _roughly(nanos: int) -> str:
    """A duration with two digits."""
    return format_duration(int(float(f"{nanos:.2g}")))


def is_off(offset_nanos: int, uncertainty_nanos: int) -> bool:
    """Whether a clock is certainly further off than is allowed."""
    return abs(offset_nanos) > CLOCK_OFFSET_NANOS_MAX + uncertainty_nanos


def ahead(offset_nanos: int) -> str:
    """An offset in words. The other clock follows them."""
    return f"{format_duration(abs(offset_nanos))} {'ahead of' if offset_nanos > 0 else 'behind'}"


def _versions(seen: Sequence[Observation], own_version: str) -> Iterator[CheckResult]:
    who: dict[str, list[str]] = {own_version: [CALLER]}
    for one in seen:
        if one.version and one.kind != PEER:  # a peer's version may be of any program
            who.setdefault(one.version, []).append(one.part)
    advice = ""
    if len(who) > 1:
        mixed = "; ".join(f"{version}: {_joined(parts)}" for version, parts in sorted(who.items()))
        advice = f"the versions differ ({mixed}); upgrade the older ones, one after the other (runbook: upgrade)"
    yield CheckResult("versions", "-", ", ".join(sorted(who)), advice)


def _levels(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    members = [one for one in _of(SUPERNODE, seen) if one.is_member]
    level = max((one.feature_level for one in members), default=0)
    if level:
        highest = {one.name or one.address: one.highest_feature_level or None for one in members}
        yield CheckResult("feature level", "-", *level_finding(level, highest))


def _joined(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)
