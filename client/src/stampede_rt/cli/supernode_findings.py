"""The findings about a supernode that other supernodes refuse, and about the feature level. The module is pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from stampede_rt.cli.output import joined

STORE_ADVICE = (
    "start it with its latest data folder. If the folder is lost, remove the supernode (stampede supernode remove), "
    "and let it join under a new id (runbook: replace one)"
)
# These words are in a text from a supernode whose state differs from the state of most members.
DIVERGED = "differs from that of most members"
# These words are in a text about a supernode whose state is not the leader's. The state of most members is unknown.
DOUBTFUL = "differs from that of the leader"
IN_DOUBT = "in doubt"
REFUSED_BY = " (says "  # comes after each reason for which another supernode refuses this one
DOUBT_ADVICE = (
    "it goes on serving. Start the supernodes that are down, if any: then most may agree. Otherwise start this "
    "supernode and the leader again, one after the other, with their data folders: an error that was only in memory "
    "ends then. If the doubt stays, remove the supernode whose release or machine you trust less (stampede supernode "
    "remove), and let it join under a new id"
)
# These words are in a text about a supernode whose release does not know the cluster's feature level.
TOO_OLD = "is of a release that is too old"
# These words are in a text from a supernode whose disk hangs.
DISK_SILENT = "the disk of its data folder has not answered"
WAITS_FOR_DISK = "waiting for its disk"
DISK_ADVICE = (
    "the other supernodes serve without this supernode; mend the disk, and the supernode serves again by itself; if "
    "the disk is lost, remove the supernode (stampede supernode remove) and let it join under a new id (runbook: "
    "replace one)"
)
REPLACE_ADVICE = (
    "remove it (stampede supernode remove), empty its folder, and let it join under a new id (runbook: replace one)"
)


def gathered(refusals: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Return for each refused supernode all reasons that other supernodes give, in one text.

    `refusals` has the reasons of each other supernode, by the id of the refused supernode.
    """
    reasons: dict[str, dict[str, None]] = {}
    for one in refusals:
        for name, why in one.items():
            reasons.setdefault(name, {})[why] = None
    return {name: "; ".join(each) for name, each in reasons.items()}


def refusal(why: str) -> tuple[str, str]:
    """Return the state of a supernode, and advice. `why` says why others refuse it, or why it does not serve."""
    if DIVERGED in why:
        return "diverged", f"{why}; {REPLACE_ADVICE}"
    if DOUBTFUL in why and REFUSED_BY not in why:
        return IN_DOUBT, f"{why}; {DOUBT_ADVICE}"
    if DISK_SILENT in why:
        return WAITS_FOR_DISK, f"{why}; {DISK_ADVICE}"
    if TOO_OLD in why:
        return "release refused", f"{why}; start it with the release of the others and the same data folder"
    return "store refused", f"{why}; {STORE_ADVICE}"


def level_finding(level: int, highest: Mapping[str, int | None]) -> tuple[str, str]:
    """Return the feature level of a cluster as a text, and advice if some supernodes keep the level from rising.

    `highest` has for each supernode the highest level that its release knows, or None if this level is not known.
    """
    goal = max((known for known in highest.values() if known is not None), default=level)
    if goal <= level:
        return str(level), ""
    older = [name for name, known in sorted(highest.items()) if known is not None and known < goal]
    silent = [name for name, known in sorted(highest.items()) if known is None]
    steps = [f"upgrade {joined(older)}"] if older else []
    steps += [f"start {joined(silent)}, whose release is unknown"] if silent else []
    if not steps:
        return f"{level}, about to rise to {goal}", ""
    return (
        f"{level}, and not all supernodes know {goal}",
        f"{' and '.join(steps)}; the level then rises by itself (runbook: upgrade)",
    )
