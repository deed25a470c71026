"""The start, the output and the end of roles, even if they fail. The roles here are small programs of their own."""

import os
import signal
import sys
import textwrap

import pytest

from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.role_processes import RoleProcesses, role_command

GOOD = """
    import json, sys
    print('{"event": "ready"}', flush=True)
    start = json.loads(sys.stdin.readline())["start_unix_nano"]
    print(json.dumps({"event": "result", "start": start}), flush=True)
"""
WAITS_FOR_EVER = """
    import signal, sys
    print('{"event": "ready"}', flush=True)
    signal.pause()
"""
DEAF = """
    import signal, sys
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    print('{"event": "ready"}', flush=True)
    signal.pause()
"""


def program(source: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(source)]


def is_gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def wait_ready(roles: RoleProcesses, count: int) -> None:
    for _ in range(count):
        assert next(roles.events(10, "getting ready"))[1] == {"event": "ready"}


def test_a_role_gets_the_start_and_gives_its_result():
    with RoleProcesses() as roles:
        roles.start("one", program(GOOD))
        roles.start("two", program(GOOD))
        wait_ready(roles, 2)
        roles.begin(17)
        results = dict(roles.events(10, "the programme"))
    assert {name: message["start"] for name, message in results.items()} == {"one": 17, "two": 17}


def test_a_role_that_is_killed_is_named_with_its_signal():
    with RoleProcesses() as roles:
        roles.start("patient one", program(WAITS_FOR_EVER))
        roles.start("other", program(WAITS_FOR_EVER))
        wait_ready(roles, 2)
        pids = dict(roles.process_ids)
        os.kill(pids["patient one"], signal.SIGKILL)
        with pytest.raises(DemoFailed, match="the patient one was killed by signal 9"):
            list(roles.events(10, "the programme"))
    assert all(is_gone(pid) for pid in pids.values())


def test_a_role_that_ends_with_a_traceback_is_quoted_in_one_line():
    with RoleProcesses() as roles:
        roles.start("clumsy one", program("raise RuntimeError('the lens is broken')"))
        with pytest.raises(DemoFailed) as failure:
            list(roles.events(10, "getting ready"))
    text = str(failure.value)
    assert "the clumsy one ended with exit code 1" in text
    assert "the lens is broken" in text
    assert "\n" not in text


def test_a_role_that_says_why_it_failed_is_quoted():
    source = """print('{"event": "failed", "message": "the film is torn"}', flush=True)"""
    with RoleProcesses() as roles:
        roles.start("projector", program(source))
        with pytest.raises(DemoFailed, match="the projector failed: the film is torn"):
            list(roles.events(10, "getting ready"))


def test_the_error_names_a_role_with_invalid_output():
    with RoleProcesses() as roles:
        roles.start("poet", program("print('roses are red', flush=True)"))
        with pytest.raises(DemoFailed, match=r"the poet sent a line that is not a report.*roses are red"):
            list(roles.events(10, "getting ready"))


def test_the_error_names_roles_that_take_too_long():
    with RoleProcesses() as roles:
        roles.start("sleeper", program(WAITS_FOR_EVER))
        wait_ready(roles, 1)
        with pytest.raises(DemoFailed, match=r"the programme took more than 0 s; still waiting for sleeper"):
            list(roles.events(0, "the programme"))


def test_the_error_names_a_role_that_cannot_be_started():
    with RoleProcesses() as roles, pytest.raises(DemoFailed, match="the ghost cannot be started"):
        roles.start("ghost", ["/nowhere/at/all"])


def test_a_role_that_ignores_sigterm_is_killed(monkeypatch):
    monkeypatch.setattr("stampede_rt_demos.staging.role_processes.END_SECONDS", 0.2)
    with RoleProcesses() as roles:
        roles.start("deaf one", program(DEAF))
        wait_ready(roles, 1)
        (pid,) = roles.process_ids.values()
    assert is_gone(pid)


def test_a_role_with_unread_output_is_ended_too():
    source = """
        while True:
            print('{"event": "progress", "items": 1}', flush=True)
    """
    with RoleProcesses() as roles:
        roles.start("chatterbox", program(source))
        assert next(roles.events(10, "getting ready"))[0] == "chatterbox"
        (pid,) = roles.process_ids.values()
    assert is_gone(pid)


def test_a_role_gets_the_environment_of_this_process_and_the_added_variables():
    source = """
        import json, os
        print(json.dumps({"event": "result", "secret": os.environ["SECRET"], "path": os.environ["PATH"]}), flush=True)
    """
    with RoleProcesses({"SECRET": "s"}) as roles:
        roles.start("one", program(source))
        ((_, message),) = roles.events(10, "the programme")
    assert (message["secret"], message["path"]) == ("s", os.environ["PATH"])


def test_a_roles_command_uses_this_interpreter():
    command = role_command("tv_watcher", "viewer", "localhost:1", 4)
    assert command[:3] == [sys.executable, "-m", "stampede_rt_demos.tv_watcher.viewer"]
    assert command[3:] == ["--address", "localhost:1", "--seconds", "4"]
