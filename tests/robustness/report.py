"""What the faults did, as a page: figures with the command and the machine they come from."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tests.robustness.campaign import Findings
from tests.robustness.scene import Outcome

TITLE = "# A run of "
NOTES_MAX = 4  # of one kind
VIOLATION_CHARS_MAX = 3000  # the whole history of a name may be long


@dataclass(frozen=True, slots=True)
class Simulated:
    """What came of the seeds."""

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
    simulated: Simulated | None

    @property
    def outcomes(self) -> list[Outcome]:
        """What became of all faults."""
        return [outcome for findings in self.findings for outcome in findings.outcomes]


def write_report(run: Run) -> str:
    """The page, in Markdown."""
    parts = [_head(run), _verdict(run), _summary(run), _faults(run.outcomes), _campaigns(run), _bites(run.outcomes)]
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
        ("calls of the directory, recorded and judged", len(operations)),
        ("names (each a history of its own)", sum(findings.names for findings in run.findings)),
        ("calls whose outcome their caller never heard", sum(operation.ambiguous for operation in operations)),
        ("calls refused for want of a majority, certainly not done", sum(one.not_done for one in run.findings)),
        ("acknowledged writes", sum(findings.acknowledged for findings in run.findings)),
        ("**acknowledged writes lost, undone, read stale or done twice, and other violations**", f"**{unexplained}**"),
        ("lease renewals / registrations of hosts without items", _leases(run.findings)),
        (
            "longest time without service, a majority alive and its links good",
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
            "**acknowledged items lost while their host lived / shown twice**",
            f"**{_sum(judged, 'lost')} / {_sum(judged, 'doubled')}**",
        ),
        ("items gone with a killed or fenced host, readers being told", _sum(judged, "gone_with_host")),
        ("puts and reads that ended with an error, told to their caller", _sum(findings, "item_calls_failed")),
    ]


def _sum(several: Iterable[object], name: str) -> int:
    return sum(getattr(one, name) for one in several)


def _simulated_rows(simulated: Simulated | None) -> list[tuple[str, object]]:
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
    """Recovery counts from the harm to the acknowledgement of a write that was begun after it."""
    rows = [_fault_row(kind, members) for kind, members in sorted(_by_kind(outcomes).items())]
    title = (
        "## Faults by kind\n\nServed again: from the harm to the acknowledgement of a write of the directory begun "
        "after it; for hosts, of a put under a new owner or incarnation. Longest without a write: the longest that the "
        "directory acknowledged none from the harm until all was healed. Waiting for a processor: the start of Python "
        "processes, and pauses of the one that measures.\n\n"
    )
    header = ("fault", "times", "served again, median", "worst", "longest without a write", "limit", "verdict")
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
        return f"**{late} of {len(members)} over it**"
    if excused := [one for one in members if one.over_limit]:
        slowest = max(one.excused_s for one in excused)
        return f"kept, but for up to {slowest:.1f} s of waiting for a processor ({len(excused)} of {len(members)})"
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
    header = ("campaign", "took", "faults", "calls", "acknowledged writes", "longest without service")
    return "## Campaigns\n\n" + _table(header, rows) if rows else ""


def _bites(outcomes: Iterable[Outcome]) -> str:
    """A fault whose effect was not seen fails the run; here is what was seen of the last of each kind."""
    rows = [(kind, members[-1].bite) for kind, members in sorted(_by_kind(outcomes).items())]
    return "## What showed that the harm was done\n\n" + _table(("fault", "the last time"), rows) if rows else ""


def _notes(outcomes: Iterable[Outcome]) -> str:
    lines: list[str] = []
    for kind, members in sorted(_by_kind(outcomes).items()):
        notes = [one.note for one in members if one.note]
        lines += [f"- {kind}: {note}" for note in notes[:NOTES_MAX]]
        if len(notes) > NOTES_MAX:
            lines.append(f"- {kind}: {len(notes) - NOTES_MAX} more like these")
    return "## What came of it\n\n" + "\n".join(lines) + "\n" if lines else ""


def _violations(run: Run) -> str:
    found = [text for findings in run.findings for text in findings.violations]
    texts = "\n\n".join(f"```\n{text[:VIOLATION_CHARS_MAX]}\n```" for text in found)
    return f"## Violations\n\n{texts}\n" if found else ""


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"


def broken_promises(run: Run) -> list[str]:
    """Histories that nothing explains, recoveries that took longer than promised or did not come, faults that did not
    bite or were not reached, seeds that failed. A line each."""
    broken = [f"{one.title}: {text.splitlines()[0]}" for one in run.findings for text in one.violations]
    broken += limits_broken(run.outcomes)
    if run.simulated is not None:
        broken += [f"simulated seed {seed}" for seed in run.simulated.failed]
    return broken


def limits_broken(outcomes: Iterable[Outcome]) -> list[str]:
    """The recoveries that took longer than promised, and those that did not come at all."""
    outcomes = list(outcomes)
    late = [
        f"{one.kind}: {one.recovery_s:.2f} s, promised {one.limit_s:.0f} s ({one.excused_s:.2f} s of it start or pause)"
        for one in outcomes
        if one.late
    ]
    return late + [f"{one.kind}: {one.note}" for one in outcomes if one.failed]
