"""`stampede demo tv-watcher`: run it, show the table, draw the picture."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.film import ATTRIBUTION
from stampede_rt_demos.staging.progress import Progress
from stampede_rt_demos.tv_watcher.conductor import Outcome, conduct
from stampede_rt_demos.tv_watcher.report import render, subtitle


def run(*, seconds: int, picture: Path | None) -> int:
    """Run the TV watcher for `seconds` and print its table; with `picture`, draw it there. Returns the exit code, 0.

    Raises DemoFailed if it cannot run, or if the picture cannot be written; that is found out before anything starts.
    """
    if picture is not None:
        _require_writable(picture)
    progress = Progress(sys.stdout)
    try:
        outcome = conduct(seconds, progress)
    finally:
        progress.close()
    print(f"\n{render(outcome.report)}")
    print(f"Film: {ATTRIBUTION}.")
    if picture is not None:
        _draw(outcome, picture)
        print(f"Picture: {picture}")
    return 0


def _draw(outcome: Outcome, picture: Path) -> None:
    from stampede_rt_demos.tv_watcher.timeline_picture import draw  # takes a second to import, and is not always needed

    try:
        draw(outcome.spans, picture, subtitle(outcome.report))
    except (ValueError, OSError) as error:
        raise DemoFailed(f"the picture {picture} cannot be drawn: {error}") from error


def _require_writable(picture: Path) -> None:
    """Raises DemoFailed if no file can be made there; makes the folder, but no file yet."""
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DemoFailed(f"the folder of the picture {picture} cannot be made: {error.strerror}") from error
    target = picture if picture.exists() else picture.parent
    if picture.is_dir() or not os.access(target, os.W_OK):
        raise DemoFailed(f"the picture cannot be written to {picture}; name a file in a folder of yours")
