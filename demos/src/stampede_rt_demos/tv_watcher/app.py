"""`stampede demo tv-watcher`: runs the demo, prints the table, draws the picture."""

from __future__ import annotations

import sys
from pathlib import Path

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.film import ATTRIBUTION
from stampede_rt_demos.staging.pictures import require_writable
from stampede_rt_demos.staging.progress import Progress
from stampede_rt_demos.tv_watcher.orchestrator import Outcome, conduct
from stampede_rt_demos.tv_watcher.report import render, subtitle


def run(*, seconds: int, picture: Path | None, certificates: bool = False) -> int:
    """Run the TV watcher for `seconds`, print its table, and with `picture` draw one there. Returns exit status 0.

    Raises DemoFailed if the demo cannot run, or, before the start, if the picture cannot be written.
    """
    if picture is not None:
        require_writable(picture)
    progress = Progress(sys.stdout)
    try:
        outcome = conduct(seconds, progress, certificates=certificates)
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
