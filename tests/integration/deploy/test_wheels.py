"""The wheels of all distributions, and programs that were installed from them alone, without the repository."""

from __future__ import annotations

import os
import re
import select
import signal
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable
from email.message import Message
from email.parser import BytesParser
from pathlib import Path

import pytest

from stampede_rt.version import VERSION
from tests.support.processes import started

ROOT = Path(__file__).resolve().parents[3]
WORKSPACE = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["uv"]["workspace"]["members"]
MEMBERS = sorted(path.parent for one in WORKSPACE for path in ROOT.glob(f"{one}/pyproject.toml"))
UV = ROOT / ".tools/bin/uv"
SECONDS = 120  # long, because the machine may be busy

pytestmark = pytest.mark.skipif(not UV.exists(), reason="`make setup` installs uv, which builds the wheels")


def uv(*words: str | Path) -> str:
    """Run uv, and return its output."""
    environment = {name: value for name, value in os.environ.items() if name != "VIRTUAL_ENV"}
    done = subprocess.run([UV, *words], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def manifest(member: Path) -> dict[str, object]:
    return dict(tomllib.loads((member / "pyproject.toml").read_text())["project"])


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheels")
    uv("build", "--quiet", "--all-packages", "--wheel", "--out-dir", folder)
    return folder


@pytest.fixture(scope="module")
def install(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Install a requirement from the wheels into a new environment, with the other packages as locked."""
    locked = wheels / "locked.txt"
    locked.write_text(uv("export", "--quiet", "--frozen", "--no-hashes", "--no-emit-workspace", "--all-groups"))

    def installed(requirement: str) -> Path:
        folder = tmp_path_factory.mktemp("installed")
        uv("venv", "--quiet", "--python", sys.executable, folder)
        words = ["--find-links", wheels, "--constraint", locked, "--python", folder]
        uv("pip", "install", "--quiet", *words, requirement)
        return folder

    return installed


def environment(installed: Path, home: Path) -> dict[str, str]:
    """The environment of a user who has only the installed packages."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("STAMPEDE_", "PYTHON", "XDG_"))}
    return kept | {"HOME": str(home), "PATH": f"{installed}/bin:/usr/bin:/bin"}


def metadata(wheel: Path) -> tuple[Message, list[str]]:
    """The metadata of a wheel, and the names of its files."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (name,) = (one for one in names if one.endswith(".dist-info/METADATA"))
        return BytesParser().parsebytes(archive.read(name)), names


def licences(wheel: Path) -> set[bytes]:
    with zipfile.ZipFile(wheel) as archive:
        return {archive.read(name) for name in archive.namelist() if "/licenses/" in name}


def test_each_wheel_has_its_licence_types_and_description_and_needs_its_siblings_of_its_own_release(
    wheels: Path,
) -> None:
    built = sorted(wheels.glob("*.whl"))
    assert len(built) == len(MEMBERS)
    for wheel in built:
        facts, names = metadata(wheel)
        assert facts["License-Expression"].startswith("Apache-2.0")
        assert (ROOT / "LICENSE").read_bytes() in licences(wheel)
        assert facts["Description-Content-Type"] == "text/markdown"
        assert str(facts.get_payload()).startswith(f"# {'Stampede RT' if facts['Name'] == 'stampede-rt' else ''}")
        assert "Typing :: Typed" in facts.get_all("Classifier", [])
        assert sum(name.count("/") == 1 and name.endswith("/py.typed") for name in names) == 1
        siblings = [one for one in facts.get_all("Requires-Dist", []) if one.startswith("stampede-rt")]
        own = re.compile(rf"stampede-rt(-[a-z-]+)?(\[[a-z]+\])?=={re.escape(facts['Version'])}(?=$|;| )")
        assert [one for one in siblings if not own.match(one) and not one.startswith("stampede-rt[files]")] == []


def test_the_wheels_have_the_files_that_are_not_python(wheels: Path) -> None:
    (page,) = wheels.glob("stampede_rt_web-*.whl")
    (local,) = wheels.glob("stampede_rt_local-*.whl")
    static = {path.relative_to(ROOT / "web/src") for path in (ROOT / "web/src").rglob("static/**/*") if path.is_file()}
    assert {str(path) for path in static} <= set(metadata(page)[1])
    assert (ROOT / "web/src/stampede_rt_web/static/vendor/uPlot.LICENSE").read_bytes() in licences(page)
    shared = {name.partition(".data/data/share/stampede-rt/")[2] for name in metadata(local)[1]}
    assert shared >= {f"prometheus/{path.name}" for path in (ROOT / "deploy/prometheus").iterdir()}


def test_all_distributions_have_one_version_and_one_licence() -> None:
    assert {manifest(member)["version"] for member in MEMBERS} == {VERSION}
    assert {(member / "LICENSE").read_bytes() for member in MEMBERS} == {(ROOT / "LICENSE").read_bytes()}


def test_the_client_without_extras_has_two_requirements_and_its_command_line_names_the_missing_extra(
    install: Callable[[str], Path], tmp_path: Path
) -> None:
    installed = install("stampede-rt")
    packages = {line.partition("==")[0] for line in uv("pip", "freeze", "--python", installed).splitlines()}
    assert packages == {"grpcio", "protobuf", "stampede-rt", "typing-extensions"}

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            words, cwd=tmp_path, env=environment(installed, tmp_path), capture_output=True, text=True, timeout=SECONDS
        )

    assert "usage: stampede" in run("stampede", "--help").stdout
    where = run("python", "-c", "import stampede_rt; print(stampede_rt.connect.__name__, stampede_rt.__file__)").stdout
    assert where.startswith(f"connect {installed}/")
    dev = run("stampede", "dev")
    assert dev.returncode != 0
    assert "it belongs to the extra [server] of stampede-rt" in dev.stderr


def test_the_services_run_as_installed_and_the_program_of_the_description_works(
    install: Callable[[str], Path], tmp_path: Path
) -> None:
    installed = install("stampede-rt[server]")
    own = environment(installed, tmp_path)
    assert sorted(path.name for path in (installed / "share/stampede-rt").iterdir()) == sorted(
        path.name for path in (ROOT / "deploy/local_cluster/share").iterdir()
    )
    command = [str(installed / "bin/stampede"), "dev", "--listen", "localhost:0"]
    with started(command, cwd=tmp_path, env=own, stderr=subprocess.STDOUT) as dev:
        address = ready_address(dev)
        client = own | {"STAMPEDE_URL": address}

        def run(*words: str) -> str:
            done = subprocess.run(words, cwd=tmp_path, env=client, capture_output=True, text=True, timeout=SECONDS)
            assert done.returncode == 0, done.stderr
            return done.stdout

        run("stampede", "put", "greeting", "hello")
        assert "hello" in run("stampede", "get", "greeting", "--last", "1h")
        assert "b'a frame'" in run("python", "-c", described_program(installed).replace("localhost:7580", address))
        dev.send_signal(signal.SIGINT)
        assert dev.wait(SECONDS) == 0


def ready_address(dev: subprocess.Popen[str]) -> str:
    assert dev.stdout is not None
    readable, _, _ = select.select([dev.stdout], [], [], SECONDS)
    line = dev.stdout.readline() if readable else ""
    found = re.match(r"Stampede RT is ready at (\S+) ", line)
    assert found is not None, line
    return found[1]


def described_program(installed: Path) -> str:
    """The first program of the description that a package registry would show."""
    (facts,) = installed.glob("lib/*/site-packages/stampede_rt-*.dist-info/METADATA")
    program = re.search(r"^```python\n(.*?)^```", facts.read_text(), re.MULTILINE | re.DOTALL)
    assert program is not None
    return program[1]
