"""deploy/compose.yaml against the Compose specification, the images' Dockerfiles and the services' own settings."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_frontend.settings import FrontendSettings
from stampede_rt_runtime.service_settings import ServiceSettings
from stampede_rt_runtime.settings import load_settings
from stampede_rt_supernode.settings import SupernodeSettings

ROOT = Path(__file__).parents[3]
COMPOSE = ROOT / "deploy/compose.yaml"
CHECK = ROOT / "deploy/docker/compose_check"
DOCKERFILES = sorted((ROOT / "deploy/docker").glob("*.Dockerfile"))
SUPERNODES = ["supernode-1", "supernode-2", "supernode-3"]
HOSTS = ["channel-host-1", "channel-host-2"]
KINDS: dict[str, tuple[str, type[ServiceSettings]]] = {
    "frontend": ("frontend", FrontendSettings),
    **dict.fromkeys(SUPERNODES, ("supernode", SupernodeSettings)),
    **dict.fromkeys(HOSTS, ("host", HostSettings)),
}


@pytest.fixture(scope="module")
def check(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The reference parser as a program."""
    if shutil.which("go") is None:
        pytest.skip("go is not installed, and the reference parser of compose files is in Go")
    got = subprocess.run(["go", "mod", "download"], cwd=CHECK, capture_output=True, text=True, check=False)
    if got.returncode != 0:
        pytest.skip(f"the reference parser cannot be downloaded: {got.stderr.strip()}")
    program = tmp_path_factory.mktemp("compose") / "compose_check"
    subprocess.run(["go", "build", "-o", program, "."], cwd=CHECK, check=True)
    return program


def read(check: Path, file: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environ = {key: value for key, value in os.environ.items() if not key.startswith("STAMPEDE_")}
    return subprocess.run(
        [check, "-f", file], env=environ | variables, cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def project(check: Path) -> dict[str, Any]:
    done = read(check, COMPOSE)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def environment(project: Mapping[str, Any], service: str) -> dict[str, str]:
    return project["services"][service]["environment"]


def settings_of(project: Mapping[str, Any], service: str) -> Any:
    kind, cls = KINDS[service]
    return load_settings(cls, service=kind, argv=[], environ=environment(project, service))


def test_the_file_keeps_the_compose_specification(project: dict[str, Any]) -> None:
    assert sorted(project["services"]) == sorted(KINDS)


@pytest.mark.parametrize(
    ("good", "bad", "complaint"),
    [
        ("healthcheck: &healthcheck", "healthchek: &healthcheck", "healthchek"),
        ("interval: 10s", "interval: [10]", "interval"),
        ("supernode-3: {condition: service_started}", "supernode-4: {condition: service_started}", "supernode-4"),
    ],
)
def test_the_reference_parser_refuses_mistakes(
    check: Path, tmp_path: Path, good: str, bad: str, complaint: str
) -> None:
    text = COMPOSE.read_text()
    assert good in text
    broken = tmp_path / "compose.yaml"
    broken.write_text(text.replace(good, bad))
    done = read(check, broken)
    assert done.returncode == 1
    assert complaint in done.stderr


@pytest.mark.parametrize("service", sorted(KINDS))
def test_every_variable_is_a_setting_that_the_service_takes(project: dict[str, Any], service: str) -> None:
    settings = settings_of(project, service)
    names = {f"STAMPEDE_{field.removesuffix('_nanos').upper()}" for field in vars(settings)}
    given = {name for name in environment(project, service) if name.startswith("STAMPEDE_")}
    assert given <= names


def test_all_supernodes_get_the_same_members_and_each_is_one_of_them(project: dict[str, Any]) -> None:
    lists = {tuple(settings_of(project, name).members) for name in SUPERNODES}
    assert lists == {tuple(f"{name}={name}:7590" for name in SUPERNODES)}
    assert [settings_of(project, name).id for name in SUPERNODES] == SUPERNODES


@pytest.mark.parametrize("service", [*SUPERNODES, *HOSTS])
def test_each_service_advertises_its_own_address_on_the_network(project: dict[str, Any], service: str) -> None:
    settings = settings_of(project, service)
    (network,) = project["services"][service]["networks"].values()
    port = settings.listen.rpartition(":")[2]
    assert settings.advertise == f"{network['ipv4_address']}:{port}"


def test_the_front_end_knows_the_supernodes_and_the_hosts_know_the_front_end(project: dict[str, Any]) -> None:
    assert list(settings_of(project, "frontend").supernodes) == [f"{name}:7590" for name in SUPERNODES]
    assert {settings_of(project, name).frontend for name in HOSTS} == {("frontend:7580",)}


@pytest.mark.parametrize("service", sorted(KINDS))
def test_the_secret_is_only_in_a_file(project: dict[str, Any], service: str) -> None:
    mounted = [secret["target"] for secret in project["services"][service]["secrets"]]
    assert [str(settings_of(project, service).secret_file)] == mounted
    assert "environment" not in project["secrets"]["stampede-secret"]


@pytest.mark.parametrize("service", [*SUPERNODES, *HOSTS])
def test_data_that_must_outlive_a_container_is_in_a_volume_of_its_own(project: dict[str, Any], service: str) -> None:
    places = {volume["target"]: volume["source"] for volume in project["services"][service]["volumes"]}
    assert places == {str(settings_of(project, service).data_dir): service}


@pytest.mark.parametrize("service", sorted(KINDS))
def test_every_container_has_limits_and_no_rights(project: dict[str, Any], service: str) -> None:
    entry = project["services"][service]
    assert set(entry["deploy"]["resources"]["limits"]) >= {"cpus", "memory", "pids"}
    assert entry["cap_drop"] == ["ALL"]
    assert entry["read_only"]
    assert entry["restart"] == "unless-stopped"
    assert entry["healthcheck"]["test"][0] == "CMD"


def test_a_host_refuses_puts_long_before_its_container_is_out_of_memory(project: dict[str, Any]) -> None:
    for name in HOSTS:
        allowed = int(project["services"][name]["deploy"]["resources"]["limits"]["memory"])
        assert settings_of(project, name).memory_bytes_max <= allowed // 2


def test_the_one_published_port_stays_on_the_machine_unless_a_variable_opens_it(
    check: Path, project: dict[str, Any]
) -> None:
    ports = [port for service in project["services"].values() for port in service.get("ports", [])]
    assert [(port["host_ip"], port["published"]) for port in ports] == [("127.0.0.1", "7580")]
    opened = json.loads(read(check, COMPOSE, STAMPEDE_PUBLISH="0.0.0.0", STAMPEDE_SUBNET="10.9.8").stdout)
    assert opened["services"]["frontend"]["ports"][0]["host_ip"] == "0.0.0.0"
    assert environment(opened, "channel-host-1")["STAMPEDE_ADVERTISE"] == "10.9.8.21:7600"


def test_every_image_of_the_file_has_its_dockerfile(project: dict[str, Any]) -> None:
    built = {service["build"]["dockerfile"] for service in project["services"].values()}
    others = {"deploy/docker/web.Dockerfile"}  # only deploy/kubernetes runs the page's server
    assert built | others == {str(file.relative_to(ROOT)) for file in DOCKERFILES}


@pytest.mark.parametrize("file", DOCKERFILES, ids=lambda file: file.name)
def test_a_dockerfile_knows_every_member_of_the_workspace_and_the_uv_of_the_makefile(file: Path) -> None:
    text = file.read_text()
    members = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["uv"]["workspace"]["members"]
    manifests = [path for member in members for path in ROOT.glob(f"{member}/pyproject.toml")]
    copied = set(re.findall(r"^COPY (\S+/pyproject\.toml) ", text, re.MULTILINE))
    assert copied == {str(path.relative_to(ROOT)) for path in manifests}
    let_in = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert all(any(path == one or path.startswith(f"{one}/") for one in let_in) for path in copied)
    version = re.search(r"^UV_VERSION := (\S+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert version is not None
    assert f"uv=={version[1]}" in text


@pytest.mark.parametrize("file", DOCKERFILES, ids=lambda file: file.name)
def test_an_image_runs_its_service_as_process_1_and_as_an_ordinary_user(file: Path) -> None:
    final = file.read_text().rpartition("FROM ")[2]
    assert re.search(r"^USER 10001:10001$", final, re.MULTILINE)
    entrypoint = re.search(r"^ENTRYPOINT (.*)$", final, re.MULTILINE)
    assert entrypoint is not None
    assert json.loads(entrypoint[1])[:2] == ["python3", "-m"]
    assert "STAMPEDE_ALLOW_INSECURE_ANYWHERE=" not in re.sub(r"^#.*$", "", final, flags=re.MULTILINE)
