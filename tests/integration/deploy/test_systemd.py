"""The units of deploy/systemd, by systemd's own tools, and the messages of the services to systemd."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_channel_host.supervisor import STOP_SECONDS_MAX
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.server import DRAIN_SECONDS
from stampede_rt_runtime.settings import EXIT_BAD_SETTINGS
from stampede_rt_supernode.app import HAND_OVER_SECONDS
from stampede_rt_web.app import SHUTDOWN_SECONDS
from tests.support.cluster import cluster_fixture
from tests.support.processes import started

ROOT = Path(__file__).resolve().parents[3]
UNITS = sorted((ROOT / "deploy/systemd").glob("*.service"))
INSTALLED = Path(sys.executable).parent
SECONDS = 60.0  # long, because the machine may be busy
EXPOSURE_MAX = 20  # `systemd-analyze security` gives 0 to 100 points
STOPS_IN_SECONDS = {
    "supernode": 2 * DRAIN_SECONDS + HAND_OVER_SECONDS,
    "frontend": 2 * DRAIN_SECONDS,
    "host": HostSettings().drain_seconds + STOP_SECONDS_MAX,
    "web": float(SHUTDOWN_SECONDS),
}

cluster = cluster_fixture(hosts=1, supernodes=1, scope="module")
has_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def analyze(*words: str | Path) -> str:
    done = subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, timeout=SECONDS, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def value(unit: Path, name: str) -> str:
    (found,) = re.findall(rf"^{name}=(.*)$", unit.read_text(), re.MULTILINE)
    return str(found)


def service_of(unit: Path) -> str:
    return unit.stem.removeprefix("stampede-")


def test_every_service_has_its_unit() -> None:
    assert {service_of(unit) for unit in UNITS} == set(STOPS_IN_SECONDS)


@has_systemd
def test_systemd_accepts_the_units_without_a_warning(tmp_path: Path) -> None:
    for unit in UNITS:  # systemd demands that the program of each unit exists
        (tmp_path / unit.name).write_text(unit.read_text().replace("/opt/stampede/bin", str(INSTALLED)))
    assert analyze("verify", "--recursive-errors=no", *tmp_path.iterdir()) == ""


@has_systemd
@pytest.mark.parametrize("unit", UNITS, ids=service_of)
def test_a_unit_leaves_its_service_few_rights(unit: Path) -> None:
    analyze("security", "--offline=true", "--no-pager", f"--threshold={EXPOSURE_MAX}", unit)


@pytest.mark.parametrize("unit", UNITS, ids=service_of)
def test_systemd_waits_longer_for_the_end_than_the_service_takes(unit: Path) -> None:
    seconds = value(unit, "TimeoutStopSec")
    assert int(seconds.removesuffix("s")) > STOPS_IN_SECONDS[service_of(unit)] + 5


@pytest.mark.parametrize("unit", UNITS, ids=service_of)
def test_each_service_accepts_the_command_of_its_unit(unit: Path, tmp_path: Path) -> None:
    program, verb, *words = value(unit, "ExecStart").replace("${STATE_DIRECTORY}", str(tmp_path)).split()
    sample = ROOT / "deploy/settings" / f"{verb}.toml"
    assert Path(words[words.index("--config") + 1]).name == sample.name
    command = [str(INSTALLED / Path(program).name), verb, *words, "--config", str(sample), "--listen", "nowhere"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, check=False)
    assert "--listen: 'nowhere' cannot be used" in done.stderr  # so the service has accepted the words before it
    assert done.returncode == EXIT_BAD_SETTINGS == int(value(unit, "RestartPreventExitStatus"))


@pytest.fixture
def supervisor(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket at which systemd would listen."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "notify"))
        one.settimeout(SECONDS)
        yield one


def commands(cluster: LocalCluster) -> dict[str, list[str]]:
    credentials = ["--secret-file", str(cluster.secret_file), "--listen", "localhost:0"]
    return {
        "supernode": ["supernode", *credentials],
        "frontend": ["frontend", "--supernodes", cluster.supernodes[0].address, *credentials],
        "host": ["host", "--frontend", cluster.address, *credentials],
        "hosts": ["host", "--frontend", cluster.address, *credentials, "--processes", "2"],
        "web": ["web", "--url", cluster.address, *credentials],
    }


@pytest.mark.parametrize("service", ["supernode", "frontend", "host", "hosts", "web"])
def test_a_service_tells_systemd_once_that_it_is_ready_and_then_that_it_stops(
    cluster: LocalCluster, supervisor: socket.socket, service: str
) -> None:
    environment = os.environ | {"NOTIFY_SOCKET": supervisor.getsockname()}
    with started([str(INSTALLED / "stampede"), *commands(cluster)[service]], env=environment) as process:
        assert supervisor.recv(100) == b"READY=1"
        process.send_signal(signal.SIGTERM)
        assert supervisor.recv(100) == b"STOPPING=1"
        assert process.wait(SECONDS) == 0
    supervisor.setblocking(False)
    with pytest.raises(BlockingIOError):
        supervisor.recv(100)
