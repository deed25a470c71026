"""A role's process starts on command, reports the outcome, and never outlives the orchestrator."""

import json
import signal
import subprocess
import sys
import textwrap
from contextlib import AbstractContextManager

import pytest

from stampede_rt_demos.staging.role import EXIT_ORPHANED, RoleSettings
from tests.support.processes import started

PRELUDE = """
    import signal, sys
    import stampede_rt as st
    from stampede_rt_demos.failures import DemoFailed
    from stampede_rt_demos.staging.role import run_role
"""
END_SECONDS = 20


def start_role(play: str) -> AbstractContextManager[subprocess.Popen[str]]:
    source = textwrap.dedent(PRELUDE) + textwrap.dedent(play) + "\nsys.exit(run_role(play))\n"
    return started([sys.executable, "-c", source, "--address", "localhost:1", "--seconds", "4"], stderr=subprocess.PIPE)


def read_event(role: subprocess.Popen[str]) -> dict[str, object]:
    assert role.stdout is not None
    event = json.loads(role.stdout.readline())
    assert isinstance(event, dict)
    return event


def begin(role: subprocess.Popen[str]) -> None:
    assert role.stdin is not None
    role.stdin.write('{"start_unix_nano": 17}\n')
    role.stdin.flush()


def test_a_role_says_that_it_is_ready_and_starts_when_told():
    with start_role("""
def play(stage):
    return {"start": stage.wait_for_start(), "length": stage.settings.length_nanos}
""") as role:
        assert read_event(role) == {"event": "ready"}
        begin(role)
        result = read_event(role)
        role.wait(END_SECONDS)
    assert (result["event"], result["start"], result["length"]) == ("result", 17, 4_000_000_000)
    assert float(str(result["cpu_seconds"])) > 0
    assert role.returncode == 0


@pytest.mark.parametrize("error", ["DemoFailed('the film is torn')", "st.Unavailable('nobody is there')"])
def test_a_failure_is_reported_as_its_message(error):
    with start_role(f"""
def play(stage):
    raise {error}
""") as role:
        printed, complained = role.communicate(timeout=END_SECONDS)
    assert json.loads(printed) == {"event": "failed", "message": error.split("'")[1]}
    assert (role.returncode, complained) == (1, "")


def test_a_defect_ends_with_a_traceback_for_the_orchestrator_to_quote():
    with start_role("""
def play(stage):
    return {}["no such key"]
""") as role:
        printed, complained = role.communicate(timeout=END_SECONDS)
    assert (printed, role.returncode) == ("", 1)
    assert complained.rstrip().endswith("KeyError: 'no such key'")


def test_a_role_ends_if_the_orchestrator_goes_before_the_start():
    with start_role("""
def play(stage):
    stage.wait_for_start()
    signal.pause()
""") as role:
        read_event(role)
        role.communicate(timeout=END_SECONDS)
    assert role.returncode == EXIT_ORPHANED


def test_a_role_ends_if_the_orchestrator_goes_while_it_plays():
    with start_role("""
def play(stage):
    stage.wait_for_start()
    stage.send_event("progress", items=1)
    signal.pause()
""") as role:
        read_event(role)
        begin(role)
        assert read_event(role) == {"event": "progress", "items": 1}
        role.communicate(timeout=END_SECONDS)
    assert role.returncode == EXIT_ORPHANED


def test_a_role_leaves_ctrl_c_to_the_orchestrator():
    with start_role("""
def play(stage):
    stage.wait_for_start()
    return {}
""") as role:
        read_event(role)
        role.send_signal(signal.SIGINT)
        begin(role)
        assert read_event(role)["event"] == "result"


@pytest.mark.parametrize("seconds", [1, 0, -5, 601])
def test_a_length_out_of_range_is_refused(seconds):
    with pytest.raises(ValueError, match="--seconds"):
        RoleSettings(address="localhost:1", seconds=seconds)
