"""What is wrong with a cluster, judged from what its parts said, and what to do about it. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from stampede_rt.cli.output import bytes_text
from stampede_rt.values.timeline import format_duration

CLOCK_OFFSET_NANOS_MAX = 50_000_000
REFUSED_LATELY_NANOS = 600 * 10**9
NAMED_MAX = 5
UNKNOWN = "unknown"  # how the clock of a peer is shown that told nothing of it
STORE_ADVICE = (
    "start it with the folder as it was last, or, if that is lost, let it go (stampede supernode remove) and "
    "have it join under a new id (runbook: replace one)"
)
# In what a supernode says of itself whose state is not the leader's.
DIVERGED = "differs from the leader's"
# In what one says of another whose release does not know the cluster's feature level.
TOO_OLD = "is of a release that is too old"
REPLACE_ADVICE = (
    "let it go (stampede supernode remove), empty its folder, and have it join under a new id (runbook: replace one)"
)
FRONTEND, SUPERNODE, HOST, PEER, CALLER = "front-end", "supernode", "host", "peer", "this caller"


def gathered(told: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """By supernode, all that several have said of why its store is refused."""
    reasons: dict[str, dict[str, None]] = {}
    for one in told:
        for name, why in one.items():
            reasons.setdefault(name, {})[why] = None
    return {name: "; ".join(each) for name, each in reasons.items()}


def refusal(why: str) -> tuple[str, str]:
    """The state of a supernode that others refuse, or that refuses to serve, for `why`; and what to do."""
    if DIVERGED in why:
        return "diverged", f"{why}; {REPLACE_ADVICE}"
    if TOO_OLD in why:
        return "release refused", f"{why}; start it with the release of the others and the same folder"
    return "store refused", f"{why}; {STORE_ADVICE}"


def level_finding(level: int, highest: Mapping[str, int | None]) -> tuple[str, str]:
    """The feature level of a cluster, and what to do if supernodes hold it down.

    `highest`: by supernode, the highest level that its release knows; None: it has not told.
    """
    goal = max((known for known in highest.values() if known is not None), default=level)
    if goal <= level:
        return str(level), ""
    older = [name for name, known in sorted(highest.items()) if known is not None and known < goal]
    silent = [name for name, known in sorted(highest.items()) if known is None]
    steps = [f"upgrade {_joined(older)}"] if older else []
    steps += [f"start {_joined(silent)}, whose release is not known"] if silent else []
    if not steps:
        return f"{level}, about to rise to {goal}", ""
    return f"{level}, and not all know {goal}", f"{' and '.join(steps)}: it rises by itself then (runbook: upgrade)"


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """What one part said when it was asked, or why it said nothing (`failure`).

    `clock_offset_nanos` is of its clock against the caller's, give or take half of the round trip. `alive`: what the
    directory says of a host; `lease_held`: what the host says itself. `knows_supernodes`: of a front-end. A peer cannot
    be asked: it told the leader, and its round trip is the caller's and its own to the supernode between them.
    `lost_for_nanos`: how long ago the directory ended the lease of a host that did not say that it leaves.
    `refused_items`: what a host refused as Overloaded since its start, the last one `refused_ago_nanos` ago.
    `is_member`: whether the other supernodes list this one. `refuses_caller`: it runs, but this caller's secret or
    certificate, or its own, keeps them from talking. `refused_because`: why other supernodes do not take its store.
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
    held_bytes: int = 0
    memory_bytes_max: int = 0
    refuses_caller: bool = False
    refused_because: str = ""
    round_trip_nanos: int | None = None
    clock_offset_nanos: int | None = None
    version: str = ""
    # Of a supernode: the cluster's feature level as it has it, and the highest that its release knows; 0: not told.
    feature_level: int = 0
    highest_feature_level: int = 0
    certificate_left_s: float | None = None

    @property
    def clock_doubt_nanos(self) -> int:
        """How far its offset may be from the truth: the way there may have taken all of the time, or none."""
        return (self.round_trip_nanos or 0) // 2

    @property
    def part(self) -> str:
        """How people call it."""
        return f"{self.kind} {self.name}".strip()


@dataclass(frozen=True, kw_only=True, slots=True)
class Inventory:
    """The channels, or the queues, of the whole directory: how many, and the names and hosts of those that are lost."""

    kind: str
    count: int
    lost: Sequence[tuple[str, str]] = ()


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One thing that was looked at; `advice` is empty if it is well."""

    part: str
    address: str
    state: str
    advice: str = ""
    seen: Observation | None = None


def diagnose(
    seen: Sequence[Observation], held: Sequence[Inventory] = (), *, own_version: str, certificate_s_min: float
) -> list[CheckResult]:
    """Everything that was looked at: first the parts, one by one, then what concerns them together."""
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
        return "no member", "the supernodes do not list it: it was removed, or never joined; leave it out"
    if one.refused_because:
        return refusal(one.refused_because)
    if one.failure and one.kind == CALLER:
        return "not valid", one.failure
    if one.failure:
        return "refused" if one.refuses_caller else "unreachable", one.failure
    if not one.ready:
        return "no leader", "it runs, but knows no leader; see the quorum"
    if not one.lease_held:
        return "fenced", "it cannot renew its lease; look at its way to the supernodes"
    return _load(one)


def _lost(one: Observation) -> tuple[str, str]:
    if one.lost_for_nanos is None:
        advice = (
            "it left, or came back without its data folder, and channels or queues are still its own: open them anew"
        )
        return "gone", advice
    advice = "its lease has ended without a word from it: it was killed, hangs, or is cut off; start it again"
    return f"lost {_roughly(one.lost_for_nanos)} ago", advice


def _load(one: Observation) -> tuple[str, str]:
    """How a host that serves stands with what it may hold."""
    if not one.refused_items:
        return "ok", ""
    state = f"{one.refused_items} puts refused"
    if one.refused_ago_nanos is None or one.refused_ago_nanos > REFUSED_LATELY_NANOS:
        return f"ok, {state} before", ""
    advice = (
        f"it refused puts as Overloaded, the last one {_roughly(one.refused_ago_nanos)} ago; it holds "
        f"{bytes_text(one.held_bytes)} of {bytes_text(one.memory_bytes_max)}: raise --memory-bytes-max, tighten the "
        "retention of its channels, or start another host (`stampede ls -l` shows who holds what)"
    )
    return state, advice


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
            "clients that are bound go on, but nobody can connect anew; start a front-end: "
            f"stampede frontend --supernodes {known}{look}"
        )
        if any(not one.knows_supernodes for one in frontends):
            advice = (
                "they run, but reach no supernode: nobody can connect anew; start the supernodes, with their folders"
            )
        elif any(one.refuses_caller for one in frontends):
            state, advice = "unknown", "they run, but nothing more is known while secret and certificates do not fit"
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
        again = f"start {down} again with its folder, or, if that is lost, replace it (runbook: replace one)"
        yield CheckResult("quorum", "-", f"{ready} of {len(members)} serve", again if down else "")
    elif len(running) >= needed:
        yield CheckResult(
            "quorum",
            "-",
            f"{len(running)} of {len(members)} run, {ready} serve",
            "a majority runs but follows no leader; look again in 5 s, and then at the network between them",
        )
    elif len(running) + refused >= needed:
        advice = "a majority runs, but nothing more is known while secret and certificates do not fit"
        yield CheckResult("quorum", "-", "unknown", advice)
    else:
        yield CheckResult(
            "quorum",
            "-",
            f"{len(running)} of {len(members)} run",
            f"the directory has no majority and refuses all changes ({needed} must run); start {down} with their "
            f"folders, or, if those are gone for good, see the runbook: {_chapter(len(members), len(running))}. "
            "Hosts cannot renew their leases: within 5 s they refuse all calls, keep what they hold, and go on with it "
            "when a majority serves again",
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
        f"{', '.join(names)}{more} belonged to {hosts}, which is gone, and what they held with it; start it again, or "
        f"open them anew: the next put into a {held.kind}, or a handle that may create it, does"
    )
    return CheckResult(f"{held.kind}s", "-", f"{len(held.lost)} of {held.count} lost", advice)


def _clocks(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    """Whose clock is off, against the services' and the caller's. Those of most services are taken to be right.

    An answer that took long tells little of a clock: beyond half of its round trip nothing is judged.
    """
    offsets = {one: one.clock_offset_nanos for one in seen if one.clock_offset_nanos is not None}
    told = {one: offset for one, offset in offsets.items() if one.clock_doubt_nanos <= CLOCK_OFFSET_NANOS_MAX}
    services = [one for one in told if one.kind != PEER]
    if not services:
        if offsets:
            quickest = format_duration(2 * min(one.clock_doubt_nanos for one in offsets))
            yield CheckResult("clocks", "-", f"{UNKNOWN}: answers took {quickest} or longer, which tells too little")
        return
    middle = sorted(offsets[one] for one in services)[(len(services) - 1) // 2]
    doubt = max(one.clock_doubt_nanos for one in services)
    off = {
        one: offset - middle
        for one, offset in offsets.items()
        if is_off(offset - middle, doubt + one.clock_doubt_nanos)
    }
    advice = [f"that of {one.part} is {ahead(nanos)} the others'; synchronise it" for one, nanos in off.items()]
    if is_off(middle, 2 * doubt):
        advice.append(f"this machine's is {ahead(-middle)} the cluster's; synchronise this one")
    yield CheckResult(
        "clocks",
        "-",
        _apart(told | {one: offsets[one] for one in off}),
        f"{'; '.join(advice)} (chrony, ntpd)" if advice else "",
    )


def _apart(offsets: Mapping[Observation, int]) -> str:
    """How far the clocks are apart, the caller's among them, and how well that is known."""
    known = [(offset, one.clock_doubt_nanos) for one, offset in offsets.items()] + [(0, 0)]
    (high, high_doubt), (low, low_doubt) = max(known), min(known, key=lambda one: (one[0], -one[1]))
    return (
        f"{_roughly(high - low)} apart, give or take {_roughly(high_doubt + low_doubt)}, "
        f"{format_duration(CLOCK_OFFSET_NANOS_MAX)} are allowed"
    )


def _roughly(nanos: int) -> str:
    """To two digits, which is as much as people need of it."""
    return format_duration(int(float(f"{nanos:.2g}")))


def is_off(offset_nanos: int, uncertainty_nanos: int) -> bool:
    """Whether a clock is certainly further from another than is allowed."""
    return abs(offset_nanos) > CLOCK_OFFSET_NANOS_MAX + uncertainty_nanos


def ahead(offset_nanos: int) -> str:
    """An offset in words, to be followed by what it is against."""
    return f"{format_duration(abs(offset_nanos))} {'ahead of' if offset_nanos > 0 else 'behind'}"


def _versions(seen: Sequence[Observation], own_version: str) -> Iterator[CheckResult]:
    who: dict[str, list[str]] = {own_version: [CALLER]}
    for one in seen:
        if one.version and one.kind != PEER:  # theirs may be of any program
            who.setdefault(one.version, []).append(one.part)
    advice = ""
    if len(who) > 1:
        mixed = "; ".join(f"{version}: {_joined(parts)}" for version, parts in sorted(who.items()))
        advice = f"not all run the same ({mixed}); upgrade the older ones, one after the other (runbook: upgrade)"
    yield CheckResult("versions", "-", ", ".join(sorted(who)), advice)


def _levels(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    members = [one for one in _of(SUPERNODE, seen) if one.is_member]
    level = max((one.feature_level for one in members), default=0)
    if level:
        highest = {one.name or one.address: one.highest_feature_level or None for one in members}
        yield CheckResult("feature level", "-", *level_finding(level, highest))


def _joined(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)
