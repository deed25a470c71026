"""Every verb: the fields of its JSON, and a quiet end when the reader of its output has gone."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt.cli.commands import full_parser, run
from stampede_rt_bench.app import _parser as bench_parser
from stampede_rt_demos.app import _parser as demo_parser
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.command_line.documented_fields import DOCUMENTED, require_fields
from tests.support.command_line.every_verb import EVERY, NOT_RUN, WAITS_FOR_NEWS, WITHOUT_JSON, Stage, stage
from tests.support.processes import started
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=2, supernodes=1, scope="module")
FINDS_FAULTS = ("doctor", "host drain")  # these verbs may report faults, and then end with status 1
SERVICE_NOUNS = ("supernode", "host", "certs", "demo", "bench")  # EVERY has verbs of these nouns, too


@pytest.fixture(autouse=True)
def environment(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))


@pytest.fixture(scope="module")
def printed_things(cluster: LocalCluster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with stage(cluster, tmp_path_factory.mktemp("printed"), "printed") as made:
        yield made


@pytest.fixture(scope="module")
def piped_things(cluster: LocalCluster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with stage(cluster, tmp_path_factory.mktemp("piped"), "piped") as made:
        yield made


def leaves(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """The verbs of a parser that have no verbs of their own, by their full names."""
    nouns = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    if not nouns:
        yield name, parser
    for noun in nouns:
        for verb, below in noun.choices.items():
            yield from leaves(below, f"{name} {verb}".strip())


def test_every_verb_of_a_client_is_run_here_and_has_the_option_output() -> None:
    verbs = dict(leaves(full_parser()))
    run_here = {name.partition(" -")[0] for name in EVERY}
    assert set(verbs) == {name for name in run_here if name.split()[0] not in SERVICE_NOUNS}
    without = {name for name, parser in verbs.items() if "--output" not in parser._option_string_actions}
    assert without == {"completion"}
    for parser in (demo_parser(), bench_parser()):
        assert all("--output" in below._option_string_actions for _, below in leaves(parser))


def status_of(words: list[str], name: str, made: Stage) -> int:
    with made.busy() if name in WAITS_FOR_NEWS else contextlib.nullcontext():
        try:
            return run(words)
        except SystemExit as end:  # --help raises this
            return int(end.code or 0)


def test_the_page_names_the_fields_of_every_verb() -> None:
    assert set(DOCUMENTED) == {name for name in EVERY if name not in WITHOUT_JSON} | set(NOT_RUN)


@pytest.mark.parametrize("name", [name for name in EVERY if name not in WITHOUT_JSON])
def test_a_verb_prints_the_fields_that_the_page_names(
    name: str, printed_things: Stage, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", printed_things.path("config"))
    status = status_of([*EVERY[name](printed_things), "--output", "json"], name, printed_things)
    out, err = capsys.readouterr()
    assert status == 0 or name in FINDS_FAULTS, err
    require_fields(name, out, may_be_empty=name == "rebalance")  # there is nothing to even out


# Commands that go on until Ctrl-C, or wait for long, with their statuses after Ctrl-C. NAME gets no new items.
# A `put` that reads a payload from standard input loads gRPC only after it has read the payload. So the test of this
# command is in tests/unit/client/cli/test_standard_input.py.
UNENDING: dict[str, tuple[int, ...]] = {
    "echo NAME": (130,),
    "sub NAME": (130,),
    "watch NAME": (130,),
    "hz NAME": (130,),
    "bw NAME": (130,),
    "top NAME": (130,),
    "get NAME now now+1h --timeout 1h": (130,),
    "group watch GROUP": (130,),
    "group match GROUP --per NAME --tolerance 1s": (130,),
    "queue get QUEUE --timeout 1h": (130,),
    "mailbox get every-waiter --timeout 1h": (130,),
    "put NAME --lines": (0, 130),
    "put NAME x --rate 5": (0, 130),
    "record NAME -o FILE": (0, 3, 130),
    "rebalance --over 1h": (130,),
}


def test_ctrl_c_ends_every_endless_command(printed_things: Stage) -> None:
    made = printed_things
    channel = made.rt.channel(made.name("quiet"))
    made.rt.group(made.name("quiet"), [channel])
    made.rt.queue(made.name("quiet"))
    names = {"NAME": made.name("quiet"), "FILE": made.path("quiet.mcap")}
    names |= {"GROUP": names["NAME"], "QUEUE": names["NAME"]}
    with contextlib.ExitStack() as stack:
        processes = {}
        for command in UNENDING:
            words = [sys.executable, "-m", "stampede_rt.cli", *(names.get(word, word) for word in command.split())]
            processes[command] = stack.enter_context(started(words, stderr=subprocess.PIPE))
        for command, process in processes.items():
            wait_until(lambda process=process: has_loaded_grpc(process.pid), command)  # type: ignore[misc]
            process.send_signal(signal.SIGINT)
        for command, process in processes.items():
            error_output = process.communicate(timeout=100)[1]
            assert process.returncode in UNENDING[command], (command, error_output)
            assert "Traceback" not in error_output, command
            assert "a defect" not in error_output, command


@pytest.mark.parametrize("owner", ["h1", "h2"])
@pytest.mark.parametrize("command", ["lag", "top --count 1 --every 0.1", "ls -l"])
def test_a_channel_with_a_copy_is_shown_once_with_the_counters_of_its_owner(
    command: str, owner: str, printed_things: Stage, capsys: pytest.CaptureFixture[str]
) -> None:
    rt, name = printed_things.rt, printed_things.name(f"copied/{owner}")
    channel = rt.channel(name, max_items=5, host=owner)
    for _ in range(8):
        channel.put(b"x")
    rt.proxy(channel, {"h1": "h2", "h2": "h1"}[owner])
    assert run([*command.split(), name, "-o", "jsonl"]) == 0
    [row] = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert row.get("host", owner) == owner
    assert row.get("accepted", channel.stats().accepted) == channel.stats().accepted
    rt.remove_proxy(channel, {"h1": "h2", "h2": "h1"}[owner])


def test_sub_prints_no_error_when_ctrl_c_closes_its_connection(printed_things: Stage) -> None:
    names = [printed_things.name(f"read/{number}") for number in range(8)]
    for name in names:
        printed_things.rt.channel(name, max_age="1h").put(b"x")
    words = [sys.executable, "-m", "stampede_rt.cli", "sub", printed_things.name("read/*"), "--from", "oldest"]
    with started(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert {process.stdout.readline().split("  ")[1].split()[0] for _ in names} == {*names}
        process.send_signal(signal.SIGINT)
        assert (process.communicate(timeout=100)[1], process.returncode) == ("", 130)


def has_loaded_grpc(pid: int) -> bool:
    """Whether a process has loaded gRPC. The command line handles Ctrl-C before it loads gRPC."""
    return "cygrpc" in Path(f"/proc/{pid}/maps").read_text()


@pytest.mark.parametrize("name", EVERY)
def test_a_verb_ends_quietly_with_status_0_when_nothing_reads_its_pipe(
    name: str, piped_things: Stage, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", piped_things.path("config"))
    reading, writing = os.pipe()
    words = list(EVERY[name](piped_things))
    with os.fdopen(writing, "w") as output:
        monkeypatch.setattr(sys, "stdout", output)
        os.close(reading)  # as `head` does when it has read its line
        status = status_of(words, name, piped_things)
        monkeypatch.undo()
    error_output = capfd.readouterr().err
    assert status == 0, error_output
    for word in ("Broken pipe", "BrokenPipe", "Traceback", "a defect", "Exception ignored"):
        assert word not in error_output
