"""docs/two-machines.md from top to bottom on two machines that are none: each block in its machine's namespace."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt_local.namespaces import NamespaceNetwork, NetworkNamespace, unavailable_because
from stampede_rt_local.process import ServiceFailed, ServiceProcess

WHY_NOT = unavailable_because()
PAGE = Path(__file__).resolve().parents[3] / "docs" / "two-machines.md"
MODULES = {
    "supernode": "stampede_rt_supernode",
    "frontend": "stampede_rt_frontend",
    "host": "stampede_rt_channel_host",
}
MACHINES = {"The first machine": 0, "The second machine": 1, "Back at the first machine": 0}
READY_SECONDS = 30.0

pytestmark = pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")


class Machine:
    """A namespace with a home folder of its own."""

    def __init__(self, namespace: NetworkNamespace, home: Path) -> None:
        self.namespace = namespace
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith("STAMPEDE_")}
        self.environment |= {"HOME": str(home), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        self.environment.pop("XDG_CONFIG_HOME", None)

    def run(self, block: str) -> str:
        done = subprocess.run(
            self.namespace.command("bash", "-euc", block),
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=40,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture
def network() -> Iterator[NamespaceNetwork]:
    with NamespaceNetwork(2) as made:
        yield made


def blocks_of(network: NamespaceNetwork, homes: list[Path]) -> Iterator[tuple[str, int, str]]:
    """Every block of the page up to the end of the scenario: its chapter, its machine, its text."""
    chapters = re.split(r"^## (.*)\n", PAGE.read_text(), flags=re.MULTILINE)
    for title, text in zip(chapters[1::2], chapters[2::2], strict=True):
        if title in MACHINES:
            for block in re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
                told = block.replace("scp -p 10.0.0.11:", f"cp -p {homes[0]}/")
                told = told.replace("10.0.0.11", network.namespaces[0].address)
                yield title, MACHINES[title], told


def test_the_recipe_for_two_machines_works_as_it_stands(
    network: NamespaceNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    homes = [tmp_path / "first", tmp_path / "second"]
    for home in homes:
        home.mkdir()
    machines = [Machine(namespace, home) for namespace, home in zip(network.namespaces, homes, strict=True)]
    services: list[ServiceProcess] = []
    printed = ""
    try:
        for _, number, block in blocks_of(network, homes):
            words = block.split()
            if words[0] == "stampede" and words[1] in MODULES:
                for name, value in machines[number].environment.items():
                    monkeypatch.setenv(name, value)
                monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
                namespace = network.namespaces[number]
                services.append(
                    ServiceProcess(f"{words[1]} {number}", MODULES[words[1]], words[2:], namespace=namespace)
                )
                services[-1].start()
                services[-1].wait_ready(READY_SECONDS)
            else:
                printed += machines[number].run(block)
    finally:
        for service in reversed(services):
            service.stop()
    assert [service.address.rpartition(":")[0] for service in services if "host" in service.name] == [
        namespace.address for namespace in network.namespaces
    ]
    assert "Everything is well." in printed
    assert "hello from the second machine" in printed


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "so this host must listen at {own}, where others can call it, and without certificates everything"),
        (("--listen", "localhost:0"), "listen at {own} (--listen {own}:"),
        (("--listen", "localhost:0", "--allow-insecure-anywhere"), "which only its own machine can call, and"),
    ],
)
def test_a_host_that_others_could_not_call_does_not_register(
    network: NamespaceNetwork, words: tuple[str, ...], told: str
) -> None:
    front, own = network.namespaces
    host = ServiceProcess("h", MODULES["host"], ["--frontend", f"{front.address}:7580", *words], namespace=own)
    host.start()
    with pytest.raises(ServiceFailed):
        host.wait_ready(READY_SECONDS)
    host.stop()
    assert host.exit_code == 2
    assert told.format(own=own.address) in host.last_lines[-1]


def test_a_front_end_tells_callers_elsewhere_that_the_supernodes_cannot_be_called(network: NamespaceNetwork) -> None:
    here, elsewhere = network.namespaces
    supernode = ServiceProcess("s", MODULES["supernode"], ["--listen", "localhost:0"], namespace=here)
    try:
        supernode.start()
        supernode.wait_ready(READY_SECONDS)
        words = ["--listen", f"{here.address}:0", "--supernodes", supernode.address, "--allow-insecure-anywhere"]
        frontend = ServiceProcess("f", MODULES["frontend"], words, namespace=here)
        frontend.start()
        frontend.wait_ready(READY_SECONDS)
        command = [sys.executable, "-m", "stampede_rt.cli", "ls", "--url", frontend.address]
        done = subprocess.run(elsewhere.command(*command), capture_output=True, text=True, timeout=30)
        frontend_side = subprocess.run(here.command(*command), capture_output=True, text=True, timeout=30)
        frontend.stop()
    finally:
        supernode.stop()
    assert done.returncode == 1
    assert f"the supernodes of this cluster are known as {supernode.address}, which only their own" in done.stderr
    assert frontend_side.returncode == 0, frontend_side.stderr
