"""The whole TV watcher: a real film goes through a real cluster for a few seconds. The demo ends all its processes."""

import contextlib
import io
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from PIL import Image

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.progress import Progress
from stampede_rt_demos.tv_watcher import app
from stampede_rt_demos.tv_watcher.orchestrator import Outcome, conduct
from stampede_rt_demos.tv_watcher.report import render
from tests.support.command_line.documented_fields import require_fields

SECONDS, RUNS_MAX = 4, 3
EXPECTED = {"captions": 1, "video": 25, "audio": 8, "motion": 25, "loudness": 8}
MARK = "TV_WATCHER_TEST_MARK"
END_SECONDS = 30


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    """A run in which no stream lagged for longer than the viewer waits. A busy machine may need several attempts."""
    for _ in range(RUNS_MAX - 1):
        with contextlib.suppress(DemoFailed):
            outcome = conduct(SECONDS, Progress(io.StringIO()))
            if all(step.complete for step in outcome.report.steps):
                return outcome
    return conduct(SECONDS, Progress(io.StringIO()))


def test_nothing_is_lost_between_hosts_and_readers(outcome: Outcome):
    assert {figure.name: figure.accepted for figure in outcome.report.figures} == {
        name: SECONDS * count for name, count in EXPECTED.items()
    }
    assert {figure.name: figure.lost for figure in outcome.report.figures} == dict.fromkeys(EXPECTED, 0)


def test_every_captions_span_holds_25_frames_and_8_blocks_and_their_features(outcome: Outcome):
    assert dict(outcome.report.expected) == EXPECTED
    assert [dict(step.counts) for step in outcome.report.steps] == [EXPECTED] * SECONDS
    assert all(step.complete for step in outcome.report.steps)


def test_the_spans_adjoin_so_that_every_item_is_watched_exactly_once(outcome: Outcome):
    steps = outcome.report.steps
    assert [step.end for step in steps[:-1]] == [step.time for step in steps[1:]]
    assert all(figure.in_step == figure.accepted for figure in outcome.report.figures)


def test_features_have_the_times_and_durations_of_their_sources(outcome: Outcome):
    assert all(step.features_keep_times for step in outcome.report.steps)


def test_a_span_is_read_only_after_its_end(outcome: Outcome):
    assert all(step.received_unix_nano > step.end for step in outcome.report.steps)


def test_both_hosts_have_channels(outcome: Outcome):
    assert len({figure.host for figure in outcome.report.figures}) == 2


def test_the_demo_reports_the_times_that_it_measured(outcome: Outcome):
    for figure in outcome.report.figures:
        assert figure.latency_p50_nanos is not None
        assert figure.latency_p99_nanos is not None
        assert 0 < figure.latency_p50_nanos <= figure.latency_p99_nanos
    assert "Nothing was lost" in render(outcome.report)


def test_the_json_of_a_run_has_the_fields_that_the_page_names(
    outcome: Outcome, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(app, "conduct", lambda *_, **__: outcome)
    assert app.run(seconds=SECONDS, picture=None, form="json") == 0
    require_fields("demo tv-watcher", capsys.readouterr().out)


def test_the_picture_shows_the_spans(outcome: Outcome, tmp_path: Path):
    assert [(len(span.frames), len(span.sound)) for span in outcome.spans] == [(25, 8)] * SECONDS
    path = tmp_path / "picture.png"
    from stampede_rt_demos.tv_watcher.timeline_picture import draw  # not at the top: it loads matplotlib

    draw(outcome.spans, path, "a test")
    with Image.open(path) as image:
        assert image.format == "PNG"
    assert path.stat().st_size < 400_000


@contextmanager
def running_demo(seconds: int) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The demo as a command. A mark in its environment distinguishes its descendants from other processes."""
    mark = uuid.uuid4().hex
    command = [sys.executable, "-m", "stampede_rt_demos", "tv-watcher", "--seconds", str(seconds)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, MARK: mark}
    )
    try:
        yield process, mark
    finally:
        process.kill()
        process.communicate()


def marked_processes(mark: str) -> dict[int, str]:
    """The command lines, by process id, of all processes that live with this mark in their environment."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (folder / "environ").read_bytes():
                found[int(folder.name)] = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # the process ended while the test looked
            continue
    return found


def wait_for_progress(process: subprocess.Popen[str]) -> None:
    """Read the output until the programme runs. If the process ends before, fails the test."""
    assert process.stdout is not None
    for line in process.stdout:
        if "in step" in line:
            return
    pytest.fail(f"the demo ended before its programme began: {process.communicate()[1]}")


needs_proc = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="finds processes by way of /proc")


@needs_proc
@pytest.mark.slow  # tests/unit/demos/staging/test_role_processes.py shows the same without a cluster
def test_the_death_of_a_role_ends_the_demo_with_one_sentence_and_leaves_no_process():
    with running_demo(60) as (process, mark):
        wait_for_progress(process)
        (viewer,) = (pid for pid, line in marked_processes(mark).items() if "tv_watcher.viewer" in line)
        os.kill(viewer, signal.SIGKILL)
        error_output = process.communicate(timeout=END_SECONDS)[1]
        assert process.returncode == 1
        assert error_output == "stampede demo tv-watcher: the viewer was killed by signal 9 before its work was done\n"
        assert marked_processes(mark) == {}


@needs_proc
def test_ctrl_c_ends_the_demo_with_status_130_and_leaves_no_process():
    with running_demo(60) as (process, mark):
        wait_for_progress(process)
        assert len(marked_processes(mark)) >= 1 + 6 + 6
        process.send_signal(signal.SIGINT)
        error_output = process.communicate(timeout=END_SECONDS)[1]
        assert process.returncode == 130
        assert "Traceback" not in error_output
        assert marked_processes(mark) == {}
