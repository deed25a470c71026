"""The table and its sentences report all measurements, also bad ones."""

from dataclasses import replace

import pytest

from stampede_rt_demos.tv_watcher.report import RunReport, bytes_text, render, subtitle
from stampede_rt_demos.tv_watcher.statistics import StepFigures, StreamFigures

SECOND = 1_000_000_000


def figures(name: str, accepted: int, received: int) -> StreamFigures:
    return StreamFigures(
        name=name,
        host="h1",
        accepted=accepted,
        received=received,
        in_step=accepted,
        payload_bytes=accepted * 40_000,
        seconds=2.0,
        latency_p50_nanos=2_400_000,
        latency_p99_nanos=None,
    )


def step(number: int) -> StepFigures:
    end = (number + 1) * SECOND
    return StepFigures(
        time=number * SECOND,
        end=end,
        text=f"caption {number}",
        counts={"captions": 1, "video": 25},
        complete=True,
        features_keep_times=True,
        received_unix_nano=end + 6_500_000,
    )


@pytest.fixture
def report() -> RunReport:
    return RunReport(
        figures=[figures("captions", 2, 2), figures("video", 50, 50)],
        steps=[step(0), step(1)],
        reference="captions",
        expected={"captions": 1, "video": 25},
        lateness_max_nanos={"video producer": 1_500_000, "caption producer": 200_000},
        role_cpu_percent={"viewer": 7.4},
        cluster_cpu_percent=61.0,
    )


def test_the_columns_of_the_table_are_aligned(report):
    heading, rule, *lines = render(report).splitlines()[:4]
    assert {len(line) for line in (heading, rule, *lines)} == {len(heading)}
    assert lines[1].split() == ["video", "h1", "50", "50", "25.0", "2.0", "MB", "2.4", "-", "0"]


def test_a_good_run_is_reported_as_good(report):
    text = " ".join(render(report).split())
    assert "every one of 2 caption spans held 25 video items" in text
    assert "Nothing was lost" in text
    assert "6.5 ms (p50), 6.5 ms (p99) after it was over" in text
    assert "1.5 ms after its time (video producer)" in text


def test_losses_are_reported_by_stream(report):
    lossy = replace(report, figures=[figures("captions", 2, 2), figures("video", 50, 47)])
    assert lossy.lost == 3
    assert "Lost between host and reader: 3 of video" in render(lossy)


@pytest.mark.parametrize(
    "fault",
    [{"counts": {"captions": 1, "video": 24}}, {"complete": False}, {"features_keep_times": False}],
)
def test_a_span_that_is_not_in_step_is_reported(report, fault):
    text = " ".join(render(replace(report, steps=[step(0), replace(step(1), **fault)])).split())
    assert "1 of 2 caption spans" in text
    assert 'The first that did not: "caption 1"' in text


def test_the_pictures_subtitle_counts_processes_channels_and_hosts(report):
    assert subtitle(report).startswith("1 processes that meet only in 2 channels on 1 hosts; ")
    assert subtitle(report).endswith("6.5 ms after its end")


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (999, "999 B"), (1000, "1.0 kB"), (25_460_000, "25.5 MB"), (2**50, "1125899.9 GB")]
)
def test_sizes_are_written_as_people_write_them(count, text):
    assert bytes_text(count) == text
