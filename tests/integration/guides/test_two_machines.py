"""docs/two-machines.md from top to bottom on two simulated machines: each block in its machine's namespace."""

from __future__ import annotations

import os
import re
import shlex
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
SECOND = "On the second machine"
# By the title of a chapter: for each part of the chapter, the number of its machine. A second part begins with SECOND.
WITH_SECRET = {"The first machine": [0], "The second machine": [1], "Back at the first machine": [0]}
WITH_CERTIFICATES = {"With certificates": [0, 1]}
READY_SECONDS = 30.0

pytestmark = pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")


class Machine:
    """A namespace with a home folder of its own."""

    def __init__(self, namespace: NetworkNamespace, home: Path) -> None:
        self.namespace, self.home = namespace, home
        self.environment = {name: value for name, value in os.environ.items() if not name.startswith("STAMPEDE_")}
        self.environment |= {"HOME": str(home), "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        self.environment.pop("XDG_CONFIG_HOME", None)

    def run(self, block: str) -> str:
        done = subprocess.run(
            self.namespace.command("bash", "-euc", block),
            env=self.environment,
            cwd=self.home,
            capture_output=True,
            text=True,
            timeout=80,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture
def network() -> Iterator[NamespaceNetwork]:
    with NamespaceNetwork(2) as made:
        yield made


def blocks_of(chapters: dict[str, list[int]], machines: list[Machine]) -> Iterator[tuple[Machine, str]]:
    """Every block of these chapters: its machine, and its text with the addresses of the namespaces."""
    split_page = re.split(r"^## (.*)\n", PAGE.read_text(), flags=re.MULTILINE)
    texts = dict(zip(split_page[1::2], split_page[2::2], strict=True))
    for title, numbers in chapters.items():
        for number, text in zip(numbers, re.split(f"(?={SECOND})", texts[title]), strict=True):
            for block in re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
                yield machines[number], with_addresses(block, machines)


def with_addresses(block: str, machines: list[Machine]) -> str:
    """The block with the addresses of the namespaces, and with `cp` in place of `scp`."""
    if "scp " in block:
        block = re.sub(r"'?10\.0\.0\.11:([^\s']+)'?", rf"{machines[0].home}/\1", block.replace("scp ", "cp "))
    for number, machine in enumerate(machines):
        block = block.replace(f"10.0.0.1{number + 1}", machine.namespace.address)
    return block


@pytest.fixture
def machines(network: NamespaceNetwork, tmp_path: Path) -> list[Machine]:
    homes = [tmp_path / "first", tmp_path / "second"]
    for home in homes:
        home.mkdir()
    return [Machine(namespace, home) for namespace, home in zip(network.namespaces, homes, strict=True)]


@pytest.mark.parametrize(
    ("chapters", "sentence"),
    [(WITH_SECRET, "hello from the second machine"), (WITH_CERTIFICATES, "client-laptop.pem")],
    ids=["secret", "certificates"],
)
def test_the_recipe_for_two_machines_works_as_it_stands(
    chapters: dict[str, list[int]], sentence: str, machines: list[Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    services: list[ServiceProcess] = []
    printed = ""
    try:
        for machine, block in blocks_of(chapters, machines):
            words = shlex.split(block.replace("\\\n", "").replace("certs/", f"{machine.home}/certs/"))
            if words[0] == "stampede" and words[1] in MODULES:
                services.append(start(machine, words, monkeypatch))
            else:
                printed += machine.run(block)
    finally:
        for service in reversed(services):
            service.stop()
    assert [service.address.rpartition(":")[0] for service in services if "host" in service.name] == [
        machine.namespace.address for machine in machines
    ]
    assert "Everything is well." in printed
    assert sentence in printed


def start(machine: Machine, words: list[str], monkeypatch: pytest.MonkeyPatch) -> ServiceProcess:
    for name, value in machine.environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
    service = ServiceProcess(words[1], MODULES[words[1]], words[2:], namespace=machine.namespace)
    service.start()
    service.wait_ready(READY_SECONDS)
    return service


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), "so this host must listen at {own}, where others can call it, and without certificates everything"),
        (("--listen", "localhost:0"), "listen at {own} (--listen {own}:"),
        (("--listen", "localhost:0", "--allow-insecure-anywhere"), "which only its own machine can call, and"),
    ],
)
def test_a_host_whose_address_others_cannot_call_or_must_not_call_without_certificates_does_not_register(
    network: NamespaceNetwork, words: tuple[str, ...], expected: str
) -> None:
    front, own = network.namespaces
    host = ServiceProcess("h", MODULES["host"], ["--frontend", f"{front.address}:7580", *words], namespace=own)
    host.start()
    with pytest.raises(ServiceFailed):
        host.wait_ready(READY_SECONDS)
    host.stop()
    assert host.exit_code == 2
    assert expected.format(own=own.address) in host.last_lines[-1]


def test_callers_at_another_machine_get_the_reason_why_they_cannot_call_the_supernodes(
    network: NamespaceNetwork,
) -> None:
    own, other = network.namespaces
    supernode = ServiceProcess("s", MODULES["supernode"], ["--listen", "localhost:0"], namespace=own)
    try:
        supernode.start()
        supernode.wait_ready(READY_SECONDS)
        words = ["--listen", f"{own.address}:0", "--supernodes", supernode.address, "--allow-insecure-anywhere"]
        frontend = ServiceProcess("f", MODULES["frontend"], words, namespace=own)
        frontend.start()
        frontend.wait_ready(READY_SECONDS)
        command = [sys.executable, "-m", "stampede_rt.cli", "ls", "--url", frontend.address]
        done = subprocess.run(other.command(*command), capture_output=True, text=True, timeout=30)
        frontend_side = subprocess.run(own.command(*command), capture_output=True, text=True, timeout=30)
        frontend.stop()
    finally:
        supernode.stop()
    assert done.returncode == 1
    assert f"the supernodes of this cluster are known as {supernode.address}, which only their own" in done.stderr
    assert frontend_side.returncode == 0, frontend_side.stderr
