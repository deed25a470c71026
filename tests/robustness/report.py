"""The page about the effects of the faults: figures, with the command and the machine of the run."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tests.robustness.campaign import Findings
from tests.robustness.faults.scene import Outcome

TITLE = "# A run of "
NOTES_MAX = 4  # for each kind of fault
VIOLATION_CHARS_MAX = 3000  # a violation quotes the whole history of a name, which may be long


@dataclass(frozen=True, slots=True)
class SimulatedRuns:
    """The results of the simulated runs, one for each seed."""

    seeds: int
    failed: Sequence[int]
    operations: int
    acknowledged: int
    puts: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the suite. `load`: the load average at its start and end, other work of the machine included."""

    command: str
    revision: str
    seconds: float
    load: tuple[float, float]
    findings: Sequence[Findings]
    simulated: SimulatedRuns | None

    @property
    def outcomes(self) -> list[Outcome]:
        """The results of the faults of all campaigns."""
        return [outcome for findings in self.findings for outcome in findings.outcomes]


def write_report(run: Run) -> str:
    """Return the report as Markdown text."""
    parts = [_head(run), _verdict(run), _summary(run), _faults(run.outcomes), _campaigns(run), _evidence(run.outcomes)]
    return "\n".join(part for part in [*parts, _notes(run.outcomes), _violations(run)] if part)


def _head(run: Run) -> str:
    made = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    machine = f"{os.cpu_count()} cores ({platform.machine()}, Linux {platform.release()})"
    return f"""{TITLE}{run.seconds / 60:.0f} minutes

Made by `{run.command}` at {run.revision}, {made}, on {machine}, with Python {platform.python_version()}; load average
{run.load[0]:.1f} at the start and {run.load[1]:.1f} at the end.
"""


def _verdict(run: Run) -> str:
    broken = broken_promises(run)
    if not broken:
        return "**Every promise was kept.**\n"
    return "**Broken promises:**\n\n" + "\n".join(f"- {one}" for one in broken) + "\n"


def _summary(run: Run) -> str:
    operations = [operation for findings in run.findings for operation in findings.operations]
    worst = max(run.findings, key=lambda findings: findings.gap_s, default=None)
    stalled = max((findings.stalled_s for findings in run.findings), default=0.0)
    unexplained = sum(len(findings.violations) for findings in run.findings)
    rows: list[tuple[str, object]] = [
        ("faults injected into real processes", len(run.outcomes)),
        ("kinds of faults", len({outcome.kind for outcome in run.outcomes})),
        ("calls to the directory, recorded and judged", len(operations)),
        ("names of channels and peers, each with its own history", sum(findings.names for findings in run.findings)),
        (
            "calls whose caller does not know whether they took effect",
            sum(operation.ambiguous for operation in operations),
        ),
        (
            "calls refused because no majority was available, certainly without effect",
            sum(one.not_done for one in run.findings),
        ),
        ("acknowledged writes", sum(findings.acknowledged for findings in run.findings)),
        (
            "**acknowledged writes that were lost, undone or done twice, stale reads, and other violations**",
            f"**{unexplained}**",
        ),
        ("lease renewals / registrations of hosts without items", _leases(run.findings)),
        (
            "longest time without service while a majority was alive and connected",
            f"{worst.gap_s:.2f} s ({worst.gap_in})" if worst else "-",
        ),
        ("longest time that the measuring process itself did not run", f"{stalled:.2f} s"),
        *_item_rows(run.findings),
        *_simulated_rows(run.simulated),
    ]
    return "## Summary\n\n" + _table(("what", "figure"), rows)


def _item_rows(findings: Sequence[Findings]) -> list[tuple[str, object]]:
    judged = [one.items for one in findings if one.items is not None]
    if not judged:
        return []
    return [
        ("channels with items / acknowledged puts", f"{_sum(judged, 'channels')} / {_sum(judged, 'acknowledged')}"),
        (
            "**acknowledged items lost although their host lived / stored twice**",
            f"**{_sum(judged, 'lost')} / {_sum(judged, 'doubled')}**",
        ),
        (
            "items lost with a killed or fenced host (the new incarnation informs the readers)",
            _sum(judged, "gone_with_host"),
        ),
        ("puts and reads that failed, with an error to their caller", _sum(findings, "item_calls_failed")),
    ]


def _sum(several: Iterable[object], name: str) -> int:
    return sum(getattr(one, name) for one in several)


def _simulated_rows(simulated: SimulatedRuns | None) -> list[tuple[str, object]]:
    if simulated is None:
        return []
    failed = ", ".join(map(str, simulated.failed)) or "none"
    return [
        ("simulated seeds / failed", f"{simulated.seeds} (0 to {simulated.seeds - 1}) / {failed}"),
        ("simulated calls judged / acknowledged writes", f"{simulated.operations} / {simulated.acknowledged}"),
        ("simulated puts that hosts acknowledged", simulated.puts),
    ]


def _leases(real: Sequence[Findings]) -> str:
    return f"{sum(one.renewals for one in real)} / {sum(one.registrations for one in real)}"


def _faults(outcomes: Iterable[Outcome]) -> str:
    """Return the table of the kinds of faults, with their recovery times."""
    rows = [_fault_row(kind, members) for kind, members in sorted(_by_kind(outcomes).items())]
    title = (
        "## Faults by kind\n\nRecovery: the time from the fault until the directory acknowledged a write that began "
        "after the fault. For a fault of hosts: the time until a host acknowledged a put under a new owner or a new "
        "incarnation. Longest time without a write: the longest time for which the directory acknowledged no write, "
        "from the fault until it was healed. Waiting for the CPU: the start of Python processes, and times when the "
        "measuring process did not run.\n\n"
    )
    header = (
        "fault",
        "times",
        "median recovery",
        "longest recovery",
        "longest time without a write",
        "limit",
        "verdict",
    )
    return title + _table(header, rows)


def _by_kind(outcomes: Iterable[Outcome]) -> dict[str, list[Outcome]]:
    kinds: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        kinds[outcome.kind].append(outcome)
    return kinds


def _fault_row(kind: str, members: Sequence[Outcome]) -> tuple[object, ...]:
    measured = [one.recovery_s for one in members if one.recovery_s is not None]
    limit = next((one.limit_s for one in members if one.limit_s is not None), None)
    return (
        kind,
        len(members),
        f"{statistics.median(measured):.2f} s" if measured else "-",
        f"{max(measured):.2f} s" if measured else "-",
        f"{max(one.gap_s for one in members):.2f} s",
        f"{limit:.0f} s" if limit is not None else "-",
        _row_verdict(members, limit),
    )


def _row_verdict(members: Sequence[Outcome], limit: float | None) -> str:
    if failed := sum(one.failed for one in members):
        return f"**{failed} of {len(members)} failed**"
    if late := sum(one.late for one in members):
        return f"**{late} of {len(members)} over the limit**"
    if excused := [one for one in members if one.over_limit]:
        slowest = max(one.excused_s for one in excused)
        return f"kept, except for up to {slowest:.1f} s of waiting for the CPU ({len(excused)} of {len(members)})"
    return "-" if limit is None else "kept"


def _campaigns(run: Run) -> str:
    rows = [
        (
            one.title,
            f"{one.seconds:.0f} s",
            len(one.outcomes),
            len(one.operations),
            one.acknowledged,
            f"{one.gap_s:.2f} s",
        )
        for one in run.findings
    ]
    header = ("campaign", "took", "faults", "calls", "acknowledged writes", "longest time without service")
    return "## Campaigns\n\n" + _table(header, rows) if rows else ""


def _evidence(outcomes: Iterable[Outcome]) -> str:
    """Return the table that shows for each kind the effect of the last fault, as the run observed it.

    The run fails if a fault had no visible effect.
    """
    rows = [(kind, members[-1].evidence) for kind, members in sorted(_by_kind(outcomes).items())]
    return "## Evidence that each fault took effect\n\n" + _table(("fault", "the last time"), rows) if rows else ""


def _notes(outcomes: Iterable[Outcome]) -> str:
    lines: list[str] = []
    for kind, members in sorted(_by_kind(outcomes).items()):
        notes = [one.note for one in members if one.note]
        lines += [f"- {kind}: {note}" for note in notes[:NOTES_MAX]]
        if len(notes) > NOTES_MAX:
            lines.append(f"- {kind}: {len(notes) - NOTES_MAX} more like these")
    return "## Observations\n\n" + "\n".join(lines) + "\n" if lines else ""


def _violations(run: Run) -> str:
    found = [text for findings in run.findings for text in findings.violations]
    texts = "\n\n".join(f"```\n{text[:VIOLATION_CHARS_MAX]}\n```" for text in found)
    return f"## Violations\n\n{texts}\n" if found else ""


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def broken_promises(run: Run) -> list[str]:
    """Return one line for each broken promise.

    These are: histories that no order of the calls explains, recoveries that took longer than promised or never
    happened, faults that had no effect or were not injected, and simulated seeds that failed.
    """
    broken = [f"{one.title}: {text.splitlines()[0]}" for one in run.findings for text in one.violations]
    broken += limits_broken(run.outcomes)
    if run.simulated is not None:
        broken += [f"simulated seed {seed}" for seed in run.simulated.failed]
    return broken


def limits_broken(outcomes: Iterable[Outcome]) -> list[str]:
    """Return one line for each recovery that took longer than promised or never happened, and each fault without
    effect.
    """
    outcomes = list(outcomes)
    late = [
        f"{one.kind}: {one.recovery_s:.2f} s, promised {one.limit_s:.0f} s (waited {one.excused_s:.2f} s for the CPU)"
        for one in outcomes
        if one.late
    ]
    return late + [f"{one.kind}: {one.note}" for one in outcomes if one.failed]
