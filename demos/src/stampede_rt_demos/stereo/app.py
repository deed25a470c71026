"""`stampede demo stereo`: runs the demo, prints its results, draws the picture."""

from __future__ import annotations

from pathlib import Path

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.clip import decode_clock
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.pictures import require_writable
from stampede_rt_demos.staging.results import print_results, progress_in
from stampede_rt_demos.stereo.orchestrator import Outcome, conduct
from stampede_rt_demos.stereo.report import facts, render


def run(*, seconds: int, picture: Path | None, certificates: bool = False, form: str = "table") -> int:
    """Run the stereo demo for `seconds`, and print its results. Returns exit status 0.

    `picture`: the path at which to draw a picture; None: draw none. Raises DemoFailed if the demo cannot run, or,
    before the start, if the picture cannot be written.
    """
    if picture is not None:
        require_writable(picture)
    progress = progress_in(form)
    try:
        outcome = conduct(seconds, progress, certificates=certificates)
    finally:
        progress.close()
    print_results(render(outcome.report), facts(outcome.report), picture, form)
    if picture is not None:
        _draw(outcome, picture)
        if form == "table":
            print(f"Picture: {picture}")
    return 0


def _draw(outcome: Outcome, picture: Path) -> None:
    from stampede_rt_demos.stereo.picture import draw  # takes a second to import, and is not always needed

    clock = decode_clock(locate_film())
    try:
        draw(outcome.report, outcome.frames, clock.loop_nanos // len(clock.offsets), picture)
    except (ValueError, OSError) as error:
        raise DemoFailed(f"the picture {picture} cannot be drawn: {error}") from error
