"""The output of the command line: tables for people, JSON for programs."""

from __future__ import annotations

import base64
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from stampede_rt.administration.output_forms import json_text
from stampede_rt.cli.colours import styled
from stampede_rt.cli.payload_text import text_of
from stampede_rt.cli.terminal import columns_max, table_lines
from stampede_rt.escaping import escaped
from stampede_rt.values.model import Policy
from stampede_rt.values.policy import FOREVER_NANOS
from stampede_rt.values.timeline import format_duration


def print_rows(rows: Sequence[Mapping[str, Any]], output_format: str, *, none: str) -> None:
    """Print rows in the `output_format` "table", "json" (an array) or "jsonl" (one line for each row).

    All rows have the same keys. `none` is the text to print instead of an empty table.
    """
    if output_format == "json":
        print(json.dumps(rows, indent=2))
    elif output_format == "jsonl":
        for row in rows:
            print(json.dumps(row))
    elif not rows:
        print(none)
    else:
        print_table(list(rows[0]), [[_cell(value) for value in row.values()] for row in rows])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return escaped(", ".join(map(str, value)) if isinstance(value, list) else str(value))


def print_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print aligned columns, within the width of the terminal. Numbers are aligned to the right."""
    cells = [[head.replace("_", " ").upper() for head in heads], *rows]
    right = [all(_is_number(row[i]) for row in cells[1:]) for i in range(len(heads))]
    for number, line in enumerate(table_lines(cells, right, columns_max())):
        print(styled(line, "bold", sys.stdout) if number == 0 else line)


def _is_number(cell: str) -> bool:
    return cell == "-" or cell.replace(".", "", 1).replace(",", "").lstrip("-").isdecimal()


def print_facts(facts: Mapping[str, Any], output_format: str) -> None:
    """Print one thing: a line for each fact, or a JSON object."""
    if output_format != "table":
        print(json_text(facts, output_format))
        return
    width = max(len(key) for key in facts)
    for key, value in facts.items():
        print(f"{key.replace('_', ' '):<{width}}  {_cell(value)}")


def print_document(value: Any, output_format: str) -> None:
    """Print one JSON value: on several lines in the format "json", on one line in the format "jsonl"."""
    print(json_text(value, output_format))


def print_done(facts: Mapping[str, Any], text: str, output_format: str) -> None:
    """Print what a verb has changed: `text` for people, `facts` as one JSON object for programs."""
    if output_format == "table":
        print(escaped(text))
    else:
        print_document(facts, output_format)


def print_behind(behind: Mapping[str, str]) -> None:
    """Warn that some services do not apply changed rules or quotas yet. `behind`: the reason for each service."""
    for name, why in behind.items():
        print(f"stampede: not in force yet at {escaped(name)}: {escaped(why)}", file=sys.stderr)


def payload_fields(payload: bytes) -> dict[str, str]:
    """Return the field of a payload for JSON: `payload` for text, `payload_base64` for other bytes."""
    text = text_of(payload)
    return {"payload_base64": base64.b64encode(payload).decode()} if text is None else {"payload": text}


def attributes_text(attributes: Mapping[str, str]) -> str:
    """Return attributes as a text for people, with a space before each."""
    return "".join(f" {escaped(key)}={escaped(value)}" for key, value in attributes.items())


def policy_text(policy: Policy) -> str:
    """Return a channel's policy as a text for people: its limits, consumers, overlap, archive and replicas."""
    parts = []
    if policy.max_age_nanos is not None:
        longest = policy.max_age_unconsumed_nanos
        more = "" if longest is None else f" (to {format_duration(longest)} for consumers)"
        parts.append(f"{format_duration(policy.max_age_nanos)}{more}")
    if policy.max_items is not None:
        parts.append(number_of(policy.max_items, "item"))
    if policy.max_bytes is not None:
        parts.append(bytes_text(policy.max_bytes))
    if policy.consumers is not None:
        parts.append(number_of(policy.consumers, "consumer"))
    parts = parts or ["10 s (default)"]
    if policy.overlap_nanos is not None:
        parts.append(f"overlap {format_duration(policy.overlap_nanos)}")
    if policy.is_recorded:
        parts.append(f"archive {_archive_text(policy)}")
    if policy.replicas:
        parts.append(replication_text(policy.replicas, policy.ack, policy.min_replicas))
    return ", ".join(parts)


def _archive_text(policy: Policy) -> str:
    age_nanos, bytes_max = policy.archive_nanos, policy.archive_bytes
    limits = [] if age_nanos is None else ["for ever" if age_nanos == FOREVER_NANOS else format_duration(age_nanos)]
    limits += [] if bytes_max is None else [f"up to {bytes_text(bytes_max)}"]
    return " ".join(limits)


def number_of(count: int, noun: str) -> str:
    """Return a number of things as a text for people, such as "1 item" or "2 items"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def bytes_text(count: float) -> str:
    """Return a number of bytes as a text for people."""
    for unit in ("B", "KiB", "MiB"):
        if count < 1024:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1024
    return f"{count:.1f} GiB"


def roughly(nanos: int) -> str:
    """Return a duration as a text for people, rounded to two digits."""
    return format_duration(int(float(f"{nanos:.2g}")))


def joined(names: Sequence[str]) -> str:
    """Join names for a sentence: with commas, and `and` before the last one."""
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


def replication_text(replicas: int | None, ack: str | None, min_replicas: int | None) -> str:
    """Return the replicas of a policy as a text for people; empty without replicas."""
    least = "" if min_replicas is None else f", at least {min_replicas}"
    return f"{number_of(replicas, 'replica')} (ack {ack or 'host'}{least})" if replicas else ""
