"""`stampede demo rover`: runs the demo, prints its results, draws the picture."""

from __future__ import annotations

from pathlib import Path

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.rover.orchestrator import conduct
from stampede_rt_demos.rover.programme import SECONDS_MIN
from stampede_rt_demos.rover.report import facts, render
from stampede_rt_demos.staging.pictures import require_writable
from stampede_rt_demos.staging.results import print_results, progress_in


def run(*, seconds: int, picture: Path | None, form: str = "table") -> int:
    """Run the demo for `seconds`, and print its results. Returns exit status 0.

    `picture`: the path at which to draw a picture; None: draw none. Raises DemoFailed if the demo cannot run, or,
    before the start, if the picture cannot be written.
    """
    if seconds < SECONDS_MIN:
        raise DemoFailed(
            f"--seconds is {seconds}; give {SECONDS_MIN} or more, because the demo continues after the loss of a host"
        )
    if picture is not None:
        require_writable(picture)
    progress = progress_in(form)
    try:
        report = conduct(seconds, progress)
    finally:
        progress.close()
    print_results(render(report), facts(report), picture, form)
    if picture is not None:
        from stampede_rt_demos.rover.picture import draw  # takes a second to import, and is not always needed

        try:
            draw(report, picture)
        except (ValueError, OSError) as error:
            raise DemoFailed(f"the picture {picture} cannot be drawn: {error}") from error
        if form == "table":
            print(f"Picture: {picture}")
    return 0
