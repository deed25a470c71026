"""`stampede doctor`: tells whether the cluster works, and what an operator should fix."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from typing import Any

from stampede_rt.cli.arguments import add_verb
from stampede_rt.cli.clock_findings import CLOCK_OFFSET_NANOS_MAX, UNKNOWN
from stampede_rt.cli.diagnosis import diagnose
from stampede_rt.cli.hosts import core_text, memory_text
from stampede_rt.cli.observations import PEER, CheckResult, Inventory, Observation
from stampede_rt.cli.output import print_rows
from stampede_rt.escaping import escaped
from stampede_rt.values.timeline import format_duration
from stampede_rt.version import VERSION

CERTIFICATE_S_MIN = 14 * 86400.0  # doctor advises to renew a certificate that ends within two weeks


def add_verbs(subparsers: Any) -> None:
    """Add the verbs of this module."""
    doctor = add_verb(subparsers, "doctor", "check every part of the cluster, and say what to fix", run_doctor)
    doctor.add_argument("--member", metavar="HOST:PORT,...", help="supernodes that doctor asks if no front-end answers")


def run_doctor(arguments: argparse.Namespace) -> int:
    """Examine every part of the cluster. Returns exit status 1 if an operator should fix something."""
    findings, listed = examine(arguments.url or os.environ.get("STAMPEDE_URL"), arguments.member)
    print_rows([_row(finding, arguments.output) for finding in findings], arguments.output, none="nothing found")
    advice = [f"{_where(finding)}: {finding.advice}" for finding in findings if finding.advice]
    if arguments.output == "table":
        print("\n" + ("\n".join(map(escaped, advice)) if advice else _all_well(listed)))
    return 1 if advice else 0


def examine(url: str | None, member: str | None) -> tuple[list[CheckResult], Sequence[Inventory]]:
    """Examine every part of a cluster. Return the findings, and the channels, queues and peers that the parts listed.

    `url` names the front-ends. `member` names the supernodes to ask if no front-end answers. Each part has a few
    seconds to answer. Raises PermissionDenied, InvalidArgument.
    """
    from stampede_rt._sync.endpoints import EndpointPool
    from stampede_rt.cli.examining import Examination
    from stampede_rt.cluster.connecting import parse_target

    target = parse_target(url or member, name=None, secret=None, zone=None)
    members = parse_target(member, name=None, secret=None, zone=None).frontends if member else ()
    frontends = target.frontends if url or not members else ()
    endpoints = EndpointPool(target.credentials)
    try:
        seen, listed = Examination(endpoints).look(frontends, members)
    finally:
        endpoints.close()
    return diagnose(seen, listed, own_version=VERSION, certificate_s_min=CERTIFICATE_S_MIN), listed


def _all_well(listed: Sequence[Inventory]) -> str:
    if not any(one.is_partial for one in listed):
        return "Everything is well."
    return (
        "This caller sees no fault. Rules of access hide some channels, queues and peers from it; ask an operator to "
        "run `stampede doctor`."
    )


def _where(finding: CheckResult) -> str:
    return finding.part if finding.address == "-" else f"{finding.part} {finding.address}"


def _row(finding: CheckResult, output_format: str) -> dict[str, Any]:
    for_people, seen = output_format == "table", finding.seen

    def duration(nanos: int | None, if_none: str | None = None) -> Any:
        return nanos if not for_people else if_none if nanos is None else format_duration(nanos)

    return {
        "part": finding.part,
        "address": finding.address,
        "state": finding.state,
        "round_trip": duration(seen.round_trip_nanos) if seen else None,
        "clock_offset": (_inexact_offset(seen) if for_people else None)
        or (duration(seen.clock_offset_nanos, UNKNOWN if seen.kind == PEER else None) if seen else None),
        "load": (_load(seen) if for_people else seen.busy_permille) if seen else None,
        "version": (seen.version or None) if seen else None,
    } | ({} if for_people else _for_programs(finding))


def _for_programs(finding: CheckResult) -> dict[str, Any]:
    """Return the fields of a finding that only the output for programs has."""
    doubt = None if finding.seen is None else finding.seen.clock_doubt_nanos
    return {"clock_uncertainty": doubt, "advice": finding.advice}


def _load(seen: Observation) -> str | None:
    """Return the load of a host as a text; None if it is not known, and for other parts."""
    memory = memory_text(seen.held_bytes, seen.memory_bytes_max) if seen.memory_bytes_max else None
    busy = None if seen.busy_permille is None else core_text(seen.busy_permille)
    return ", ".join(filter(None, (busy, memory))) or None


def _inexact_offset(seen: Observation | None) -> str | None:
    """Return a text for the clock offset of a part with a slow answer; None if the answer gives a useful offset."""
    if seen is None or seen.clock_offset_nanos is None or seen.clock_doubt_nanos <= CLOCK_OFFSET_NANOS_MAX:
        return None
    return f"within {format_duration(abs(seen.clock_offset_nanos) + seen.clock_doubt_nanos)}"
