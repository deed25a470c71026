"""Derives findings about a cluster, each with advice, from the answers of its parts. The module is pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stampede_rt.cli.clock_findings import clock_findings
from stampede_rt.cli.observations import CALLER, FRONTEND, HOST, PEER, SUPERNODE, CheckResult, Inventory, Observation
from stampede_rt.cli.output import bytes_text, joined, number_of, roughly
from stampede_rt.cli.supernode_findings import level_finding, refusal

REFUSED_LATELY_NANOS = 600 * 10**9  # a refusal is recent for 10 minutes; only a recent refusal gives advice
NAMED_MAX = 5  # lost channels or queues that a finding names
SHORT_PART = 3  # a certificate that is valid for a short time is due for renewal when a third of that time is left


def diagnose(
    seen: Sequence[Observation], held: Sequence[Inventory] = (), *, own_version: str, certificate_s_min: float
) -> list[CheckResult]:
    """Return all findings: first one about each part, then the findings about the whole cluster.

    A certificate that ends within `certificate_s_min` seconds gives advice.
    """
    parts = [_of_part(one, certificate_s_min) for one in seen]
    common_findings = [
        *_frontends(seen),
        *_quorum(seen),
        *_hosts(seen),
        *map(_holdings, held),
        *_denials(seen),
        *_quotas(seen),
        *clock_findings(seen),
    ]
    return [*parts, *common_findings, *_versions(seen, own_version), *_levels(seen)]


def _of_part(one: Observation, certificate_s_min: float) -> CheckResult:
    state, advice = _state(one)
    left_s = one.certificate_left_s
    if not advice and left_s is not None and left_s < min(certificate_s_min, one.certificate_lasts_s / SHORT_PART):
        left = f"{left_s / 86400:.1f} days" if left_s > 2 * 86400 else f"{left_s / 3600:.1f} hours"
        advice = f"its certificate ends in {left}; issue it anew (stampede certs renew)"
        if left_s < 0:
            advice = "its certificate has expired; issue it anew (stampede certs renew)"
    return CheckResult(one.part, one.address, state, advice, one)


def _state(one: Observation) -> tuple[str, str]:
    if not one.alive:
        return _lost(one)
    if not one.knows_supernodes:
        return "no supernode", one.failure
    if not one.is_member:
        advice = "it was removed, or never joined; state only members in --supernodes and --member"
        return "no member", f"the supernodes do not list it: {advice}"
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
    if one.archive_failure:
        return _archive(one)
    return _archive_store(one) if one.archive_store_failure else _load(one)


def _archive(one: Observation) -> tuple[str, str]:
    """Return the state of a host whose archive cannot be written, and advice."""
    advice = (
        f"its archive takes no items of {number_of(one.archive_failing_channels, 'channel')}: {one.archive_failure}. "
        "Free its disk, or let the host write its folder again (--archive); the host tries again every second. Until "
        'then the items stay in memory up to max_bytes, puts with ack="disk" are refused, and readers go on'
    )
    return "archive fails", advice


def _archive_store(one: Observation) -> tuple[str, str]:
    """Return the state of a host whose object store fails, and advice."""
    advice = (
        f"{one.archive_store_failure}. Look at the network to the store, its bucket and the credentials in the host's "
        "environment; the host tries again at least every minute. Until then closed files stay on its disk, up to "
        "--archive-bytes-max (or max_archive of st.host), reads of moved files fail, and live readers go on"
    )
    return "store fails", advice


def _number_of(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _lost(one: Observation) -> tuple[str, str]:
    if one.lost_for_nanos is None:
        advice = (
            "it left, or came back without its data folder, but still owns channels or queues; see the lines on "
            "channels and queues"
        )
        return "gone", advice
    advice = "its lease has ended: the host was killed, hangs, or cannot reach the supernodes; start it again"
    return f"lost {roughly(one.lost_for_nanos)} ago", advice


def _load(one: Observation) -> tuple[str, str]:
    """Return the state of a part that serves, and advice if it has lately refused puts or calls as Overloaded."""
    kinds = (
        (one.refused_items, "put", one.refused_ago_nanos),
        (one.refused_calls, "call", one.refused_call_ago_nanos),
    )
    refused = [(_number_of(count, what), ago) for count, what, ago in kinds if count]
    if not refused:
        return "ok", ""
    state = f"{' and '.join(text for text, _ in refused)} refused"
    advice = " ".join(filter(None, (_refused_puts(one), _refused_calls(one))))
    return (state, advice) if advice else (f"ok, {state} before", "")


def _refused_puts(one: Observation) -> str:
    """Return advice if the host has lately refused puts; otherwise an empty text."""
    if one.refused_ago_nanos is None or one.refused_ago_nanos > REFUSED_LATELY_NANOS:
        return ""
    refused = f"it refused puts as Overloaded, the last one {roughly(one.refused_ago_nanos)} ago; "
    if one.refused_for_archive:
        return refused + (
            "its archive has no room (--archive-bytes-max, or max_archive of st.host): record less (archive, "
            "archive_bytes), raise the limit, delete the folders of deleted channels, or start another host with an "
            "archive"
        )
    return refused + (
        f"it holds {bytes_text(one.held_bytes)} of {bytes_text(one.memory_bytes_max)}: raise --memory-bytes-max (or "
        "max_memory of st.host), tighten the retention of its channels, or start another host (`stampede ls -l` shows "
        "the host and the counters of each channel)"
    )


def _refused_calls(one: Observation) -> str:
    """Return advice if the part has lately refused or ended calls; otherwise an empty text."""
    if one.refused_call_ago_nanos is None or one.refused_call_ago_nanos > REFUSED_LATELY_NANOS:
        return ""
    return (
        f"it refused or ended calls as Overloaded, the last one {roughly(one.refused_call_ago_nanos)} ago; its log "
        "gives the reason: too many streams, reads or channels at a time, or a reader that took nothing. Close some of "
        "them, or start another host"
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
    down = joined([one.name or one.address for one in members if one.failure and not one.refuses_caller])
    running, ready = [one for one in members if not one.failure], sum(one.ready and not one.failure for one in members)
    needed = len(members) // 2 + 1
    if ready >= needed:
        advice = (
            f"start {down} again with its data folder. If the folder is lost, replace the supernode "
            "(runbook: replace one)"
        )
        kept = ", only in memory" if any(one.in_memory for one in running) else ""
        yield CheckResult("quorum", "-", f"{ready} of {len(members)} serve{kept}", advice if down else "")
    elif len(running) >= needed:
        yield CheckResult(
            "quorum",
            "-",
            f"{len(running)} of {len(members)} run, {ready} serve",
            "a majority runs, but has no leader; look again in 5 s"
            + (f", then start {down} again with its data folder" if down else "")
            + ", then check the network between them",
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
            f"data folders. If the folders are lost, see the runbook: {_chapter(len(members), len(running))}. "
            "Hosts cannot renew their leases: within 5 s they refuse all calls. They keep their items, and serve them "
            "again when a majority serves again",
        )


def _chapter(members: int, running: int) -> str:
    return "lose all" if running == 0 else "lose two" if members == 3 else "restore"


def _hosts(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    if any(one.kind == SUPERNODE and one.ready and not one.failure for one in seen) and not _of(HOST, seen):
        yield CheckResult(HOST, "-", "none", "no channel host has registered; start one with `stampede host`")


def _holdings(held: Inventory) -> CheckResult:
    count = f"{held.count} that this caller may list" if held.is_partial else f"{held.count}"
    states, advice = [], []
    if held.lost:
        names, hosts = _names(held.lost)
        states.append(f"{len(held.lost)} of {count} lost")
        advice.append(
            f"the items of {names} were lost with {hosts}; start {hosts} again, or open the {held.kind}s at "
            f"another host: the next put into a {held.kind} does that"
        )
    if held.recorded:
        names, hosts = _names(held.recorded)
        states.append(f"{len(held.recorded)} of {count} recorded at an absent host")
        advice.append(
            f"start {hosts} again with the same archive, which has the recorded items of {names}. Another host that "
            "takes a channel over has these items only if the archive is in an object store"
        )
    return CheckResult(f"{held.kind}s", "-", ", ".join(states) or f"{count}, none lost", ". ".join(advice))


def _names(items: Sequence[tuple[str, str]]) -> tuple[str, str]:
    """Return the first names, and all hosts, as text."""
    more = f" and {len(items) - NAMED_MAX} more" if len(items) > NAMED_MAX else ""
    return ", ".join(name for name, _ in items[:NAMED_MAX]) + more, joined(sorted({host for _, host in items}))


def _quotas(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    """Report the calls that were refused because of a quota, with advice if the last refusal is recent.

    Yields nothing if no call was refused.
    """
    refusing = [one for one in seen if one.quota_refusals]
    if not refusing:
        return
    count, last = sum(one.quota_refusals for one in refusing), min(one.quota_refused_ago_nanos or 0 for one in refusing)
    where = joined([f"{one.part} ({one.quota_refusals})" for one in refusing])
    advice = (
        "`stampede quota use` shows which callers are beyond which quota, and `stampede quota set` raises a quota"
        if last <= REFUSED_LATELY_NANOS
        else ""
    )
    state = f"{_number_of(count, 'call')} refused, the last one {roughly(last)} ago, at {where}"
    yield CheckResult("quotas", "-", state, advice)


def _denials(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    """Report the calls that rules of access denied, without advice: only a person can tell whether a rule is wrong.

    Yields nothing if no call was denied.
    """
    denying = [one for one in seen if one.denials]
    if not denying:
        return
    count, last = sum(one.denials for one in denying), min(one.denied_ago_nanos or 0 for one in denying)
    where = joined([f"{one.part} ({one.denials})" for one in denying])
    state = f"{_number_of(count, 'call')} denied, the last one {roughly(last)} ago, at {where}"
    yield CheckResult("access", "-", state)


def _versions(seen: Sequence[Observation], own_version: str) -> Iterator[CheckResult]:
    who: dict[str, list[str]] = {own_version: [CALLER]}
    for one in seen:
        if one.version and one.kind != PEER:  # a peer may state the version of any program
            who.setdefault(one.version, []).append(one.part)
    advice = ""
    if len(who) > 1:
        mixed = "; ".join(f"{version}: {joined(parts)}" for version, parts in sorted(who.items()))
        advice = f"the versions differ ({mixed}); upgrade the older ones, one after the other (runbook: upgrade)"
    yield CheckResult("versions", "-", ", ".join(sorted(who)), advice)


def _levels(seen: Sequence[Observation]) -> Iterator[CheckResult]:
    members = [one for one in _of(SUPERNODE, seen) if one.is_member]
    level = max((one.feature_level for one in members), default=0)
    if level:
        highest = {one.name or one.address: one.highest_feature_level or None for one in members}
        yield CheckResult("feature level", "-", *level_finding(level, highest))
