"""Lines between roles and the orchestrator are the same after encoding and decoding. Malformed lines are refused."""

import pytest

from stampede_rt_demos.staging import messages
from stampede_rt_demos.tv_watcher import steps
from stampede_rt_demos.tv_watcher.statistics import StepFigures

STEP = StepFigures(
    time=1,
    end=2,
    text='a caption, "quoted", über zwei\nLines',
    counts={"video": 25},
    complete=False,
    features_keep_times=True,
    received_unix_nano=1_700_000_000_123_456_789,
)


def test_a_step_is_the_same_after_encoding_as_a_line():
    line = messages.encode("step", **steps.step_fields(STEP))
    assert "\n" not in line
    assert steps.step_of(messages.decode(line)) == STEP


def test_the_start_is_the_same_after_encoding_as_a_line():
    assert messages.decode_start(messages.encode_start(1_700_000_000_123_456_789)) == 1_700_000_000_123_456_789


@pytest.mark.parametrize("line", ["", "hello", "[]", "{}", '{"event": "dance"}', "3"])
def test_a_line_that_is_no_event_is_refused(line):
    with pytest.raises(messages.BadMessage):
        messages.decode(line)


@pytest.mark.parametrize("line", ["", "{}", '{"start_unix_nano": 1.5}', '{"start_unix_nano": null}', "[1]"])
def test_a_line_that_is_no_start_is_refused(line):
    with pytest.raises(messages.BadMessage):
        messages.decode_start(line)


def test_an_unknown_event_is_not_sent():
    with pytest.raises(messages.BadMessage, match="dance"):
        messages.encode("dance")


def test_a_step_without_its_counts_is_refused():
    with pytest.raises(messages.BadMessage, match="counts"):
        steps.step_of({"event": "step", "time": 1, "end": 2, "text": ""})
