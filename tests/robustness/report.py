"""What the faults did, as a page: figures with the command and the machine they come from."""

from __future__ import annotations

import os
import platform
import statistics
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tests.robustness.campaign import Findings
from tests.robustness.scene import Outcome


@dataclass(frozen=True, slots=True)
class Simulated:
    """What came of the seeds."""

    seeds: int
    failed: Sequence[int]
    operations: int
    acknowledged: int
    puts: int
    seconds: float


def write_report(command: str, state: str, load: str, real: Sequence[Findings], simulated: Simulated | None) -> str:
    """The page, in Markdown."""
    outcomes = [outcome for findings in real for outcome in findings.outcomes]
    parts = [
        _head(command, state, load),
        _summary(real, outcomes, simulated),
        _faults(outcomes),
        _notes(outcomes),
    ]
    return "\n".join(part for part in parts if part)


def _head(command: str, state: str, load: str) -> str:
    return f"""# Robustness

Made by `{command}` at {state}, on {os.cpu_count()} cores ({platform.machine()}, Linux {platform.release()}, Python
{platform.python_version()}); {load}. Every history that callers recorded was judged linearizable, and at no moment did
two hosts believe that they own a channel: a violation would have ended the run without this page.
"""


def _summary(real: Sequence[Findings], outcomes: Sequence[Outcome], simulated: Simulated | None) -> str:
    operations = [operation for findings in real for operation in findings.operations]
    worst = max(real, key=lambda findings: findings.gap_s, default=None)
    rows = [
        ("faults injected into real processes", len(outcomes)),
        ("calls recorded and judged", len(operations)),
        ("names (each a history of its own)", sum(findings.names for findings in real)),
        ("calls whose outcome their caller never heard", sum(operation.ambiguous for operation in operations)),
        ("calls refused for want of a majority, certainly not done", sum(findings.not_done for findings in real)),
        ("acknowledged writes", sum(findings.acknowledged for findings in real)),
        ("**acknowledged writes lost**", "**0**"),
        ("lease renewals / registrations of hosts", _leases(real)),
        ("longest time without service, a majority alive", f"{worst.gap_s:.2f} s ({worst.gap_in})" if worst else "-"),
    ]
    if simulated is not None:
        failed = ", ".join(map(str, simulated.failed)) or "none"
        rows += [
            ("simulated seeds / failed", f"{simulated.seeds} / {failed}"),
            ("simulated calls judged / acknowledged writes", f"{simulated.operations} / {simulated.acknowledged}"),
            ("simulated puts that hosts acknowledged", simulated.puts),
        ]
    return "## Summary\n\n" + _table(("what", "figure"), rows)


def _leases(real: Sequence[Findings]) -> str:
    return f"{sum(one.renewals for one in real)} / {sum(one.registrations for one in real)}"


def _faults(outcomes: Sequence[Outcome]) -> str:
    """Recovery counts from the harm to the acknowledgement of a write that was begun after it."""
    kinds: dict[str, list[Outcome]] = defaultdict(list)
    for outcome in outcomes:
        kinds[outcome.kind].append(outcome)
    rows = []
    for kind, members in kinds.items():
        measured = [one.recovery_s for one in members if one.recovery_s is not None]
        limit = members[0].limit_s
        late = sum(limit is not None and took > limit for took in measured)
        rows.append(
            (
                kind,
                len(members),
                f"{statistics.median(measured):.2f} s" if measured else "-",
                f"{max(measured):.2f} s" if measured else "-",
                f"{limit:.0f} s" if limit is not None else "-",
                "-" if limit is None else "kept" if not late else f"**{late} of {len(members)} over it**",
            )
        )
    title = "## Faults by kind\n\nServed again: from the harm to the acknowledgement of a write begun after it.\n\n"
    return title + _table(("fault", "times", "served again, median", "worst", "limit", "verdict"), rows)


def _notes(outcomes: Sequence[Outcome]) -> str:
    lines = [f"- {outcome.kind}: {outcome.note}" for outcome in outcomes if outcome.note]
    return "## What was seen\n\n" + "\n".join(lines) + "\n" if lines else ""


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines) + "\n"


def limits_broken(outcomes: Iterable[Outcome]) -> list[str]:
    """The recoveries that took longer than promised, and those that did not come at all."""
    outcomes = list(outcomes)
    late = [
        f"{one.kind}: {one.recovery_s:.2f} s, promised {one.limit_s:.0f} s"
        for one in outcomes
        if one.recovery_s is not None and one.limit_s is not None and one.recovery_s > one.limit_s
    ]
    return late + [f"{one.kind}: {one.note}" for one in outcomes if one.failed]
