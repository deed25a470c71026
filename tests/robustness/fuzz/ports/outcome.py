"""The observations of a run against one port, and its findings."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import grpc

FINDINGS_MAX = 40
BROKEN = (grpc.StatusCode.INTERNAL, grpc.StatusCode.UNKNOWN)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A call that broke a rule. `what`: the broken rule. `requests`: the messages of the call, as hexadecimal text."""

    what: str
    method: str
    requests: tuple[str, ...] = ()

    @property
    def kind(self) -> tuple[str, str]:
        """Findings of one kind are reported once."""
        return self.method, self.what[:60]


@dataclass
class Outcome:
    """Memory is the resident set of the process behind the port, in MiB. `starved_share`: the greatest part of two
    seconds for which a thread of a service waited for a processor. `excused`: the leases that were lost while a
    service waited for a processor."""

    port: str
    seed: int
    inputs: int = 0
    calls: int = 0
    seconds: float = 0.0
    codes: Counter[str] = field(default_factory=Counter)
    by_method: Counter[str] = field(default_factory=Counter)
    findings: list[Finding] = field(default_factory=list)
    before_mib: float = 0.0
    most_mib: float = 0.0
    after_mib: float = 0.0
    starved_share: float = 0.0
    leases_lost: int = 0
    excused: int = 0
    good_calls: int = 0
    good_failures: list[str] = field(default_factory=list)

    def add(self, finding: Finding) -> None:
        """Add the finding, unless a finding of its kind is there."""
        if len(self.findings) < FINDINGS_MAX and all(one.kind != finding.kind for one in self.findings):
            self.findings.append(finding)

    def __str__(self) -> str:
        codes = ", ".join(f"{name} {count}" for name, count in self.codes.most_common())
        lines = [
            f"{self.port}, seed {self.seed}: {self.inputs:,} inputs in {self.calls:,} calls, {self.seconds:.0f} s, "
            f"{self.inputs / max(1e-9, self.seconds):,.0f}/s",
            f"  memory {self.before_mib:.0f}, {self.most_mib:.0f}, {self.after_mib:.0f} MiB (first, most, after)",
            f"  answers: {codes}",
            f"  leases lost: {self.leases_lost}, {self.excused} of them while a service waited for a processor "
            f"(at most {self.starved_share:.0%} of 2 s)",
            f"  good calls: {self.good_calls}, failed: {len(self.good_failures)} {self.good_failures[:3]}",
        ]
        for one in self.findings:
            lines.append(f"  FOUND {one.method}: {one.what}")
            lines += [f"    request of {len(request) // 2} bytes: {request[:2000]}" for request in one.requests]
        return "\n".join(lines)
