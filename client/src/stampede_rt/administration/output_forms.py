"""The option --output, which the verbs of clients and of services share, and JSON in its forms."""

from __future__ import annotations

import argparse
import json
from typing import Any

FORMS = ("table", "json", "jsonl")


def add_output(parser: argparse.ArgumentParser, default: str = "table") -> None:
    """Add the option for the output format."""
    parser.add_argument("-o", "--output", choices=FORMS, default=default, help="the form of the output; default table")


def json_text(value: Any, output_format: str) -> str:
    """Return one JSON value: on several lines in the format "json", on one line in the format "jsonl"."""
    return json.dumps(value, indent=2 if output_format == "json" else None)
