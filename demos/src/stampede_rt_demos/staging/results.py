"""Prints the results of a demo: sentences for people, or one JSON object for programs."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from stampede_rt.administration.output_forms import json_text
from stampede_rt_demos.staging.film import ATTRIBUTION
from stampede_rt_demos.staging.progress import Progress


def progress_in(form: str) -> Progress:
    """Return the progress: on standard output for people, otherwise on standard error."""
    return Progress(sys.stdout if form == "table" else sys.stderr)


def print_results(text: str, facts: Mapping[str, object], picture: Path | None, form: str) -> None:
    """Print the results, in the form "table" as `text`, otherwise `facts` with the film and the path of the picture."""
    if form == "table":
        print(f"\n{text}")
        print(f"Film: {ATTRIBUTION}.")
        return
    shown = None if picture is None else str(picture)
    print(json_text({**facts, "film": ATTRIBUTION, "picture": shown}, form), flush=True)
