"""Every snippet of the README, run as a reader would run it."""

from __future__ import annotations

import os
import re
import select
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.processes import started
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
ROOT = Path(__file__).resolve().parents[3]
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
PROGRAMS = [text for language, text in BLOCKS if language == "python"]
COMMANDS = [
    line.split("  #")[0].strip()
    for language, text in BLOCKS
    if language == "sh"
    for line in text.splitlines()
    if line.startswith("stampede ")
]
ENDLESS = ("echo", "hz")


def environment(cluster: LocalCluster) -> dict[str, str]:
    return os.environ | {"STAMPEDE_URL": cluster.address, "STAMPEDE_SECRET_FILE": str(cluster.secret_file)}


def test_the_readme_has_programs_and_commands() -> None:
    assert len(PROGRAMS) == 2
    assert len(COMMANDS) >= 6


def test_the_first_program_prints_its_own_items(cluster: LocalCluster) -> None:
    done = run_program(PROGRAMS[0], cluster)
    assert "b'the next frame'" in done
    assert "b'a frame' {'enc': 'jpeg'}" in done
    assert "0 NOT_YET" in done


def test_the_awaited_program_prints_its_own_items(cluster: LocalCluster) -> None:
    assert "b'live'" in run_program(PROGRAMS[1], cluster)


@pytest.mark.timeout(300)  # mypy also reads the types of gRPC and protobuf
def test_the_programs_pass_a_strict_type_check(tmp_path: Path) -> None:
    for number, program in enumerate(PROGRAMS):
        (tmp_path / f"program_{number}.py").write_text(program)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "--follow-imports=silent", "."],
        cwd=tmp_path, capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def run_program(program: str, cluster: LocalCluster) -> str:
    text = program.replace("localhost:7580", cluster.address)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", text],
        env=environment(cluster), capture_output=True, text=True, timeout=40, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.parametrize("command", [line for line in COMMANDS if line.split()[1] not in ENDLESS])
def test_every_command_works(cluster: LocalCluster, command: str) -> None:
    prepare(cluster)
    arguments = [sys.executable, "-m", "stampede_rt.cli", *shlex.split(command)[1:]]
    done = subprocess.run(arguments, env=environment(cluster), capture_output=True, text=True, timeout=40, check=False)
    assert done.returncode == 0
    # On a slow machine retention may have taken items of earlier tests: a get says so beside its answer.
    assert done.stderr == "" or done.stderr.startswith("stampede: COLLECTED: max_age (10 s)")
    assert done.stdout


@pytest.mark.parametrize("command", [line for line in COMMANDS if line.split()[1] in ENDLESS])
def test_every_endless_command_prints_until_interrupted(cluster: LocalCluster, command: str) -> None:
    prepare(cluster)
    arguments = [sys.executable, "-m", "stampede_rt.cli", *shlex.split(command)[1:]]
    with started(arguments, env=environment(cluster)) as process:
        assert process.stdout is not None
        while process.poll() is None and command.split()[1] == "echo" and not ready(process):
            prepare(cluster)
        assert process.stdout.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 130


def ready(process: subprocess.Popen[str]) -> bool:
    """Whether a line is there to read."""
    return bool(select.select([process.stdout], [], [], 0.05)[0])


def prepare(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        rt.channel("cam/left", max_age="10s").put(b"item")
