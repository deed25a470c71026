"""The parts of the images' proof that can be wrong in silence: merging settings, naming services, declaring imports."""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.util
import re
import struct
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]
PACKAGES = {
    tomllib.loads(path.read_text())["project"]["name"]: path.parent
    for path in [ROOT / "client/pyproject.toml", *ROOT.glob("services/*/pyproject.toml")]
}
IMAGE = {"Env": ["PATH=/bin", "A=image"], "User": "10001:10001", "Entrypoint": ["run"], "Cmd": ["it"]}
SERVICE: dict[str, Any] = {
    "image": "i",
    "cap_drop": ["ALL"],
    "security_opt": ["no-new-privileges:true"],
    "networks": {"n": {"ipv4_address": "10.0.0.2"}},
    "healthcheck": {"test": ["CMD", "healthy"]},
    "deploy": {"resources": {"limits": {"memory": "1", "pids": 1}}},
}


def load(name: str) -> ModuleType:
    """A module of the proof, which is a program and no package."""
    spec = importlib.util.spec_from_file_location(f"proof_{name}", ROOT / f"deploy/docker/proof/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


plan, name_server = load("plan"), load("name_server")


def planned(**changes: Any) -> Any:
    project = {"services": {"s": SERVICE | changes}, "secrets": {"k": {"file": "/k"}}}
    return plan.plan_project(project, {"i": IMAGE}, "/volumes")["s"]


def test_the_file_wins_over_the_image() -> None:
    container = planned(environment={"A": "file", "B": "new"})
    assert container.env == {"PATH": "/bin", "A": "file", "B": "new"}


def test_a_command_keeps_the_entrypoint_and_an_entrypoint_drops_the_command_of_the_image() -> None:
    assert planned().argv == ["run", "it"]
    assert planned(command=["that"]).argv == ["run", "that"]
    assert planned(entrypoint=["other"]).argv == ["other"]


def test_secrets_volumes_and_temporary_folders_become_mounts() -> None:
    mounts = planned(
        secrets=[{"source": "k", "target": "name"}],
        volumes=[{"type": "volume", "source": "v", "target": "/data"}],
        tmpfs=["/tmp"],
    ).mounts
    assert sorted(mounts) == [("bind", "/volumes/v", "/data"), ("ro", "/k", "/run/secrets/name"), ("tmpfs", "", "/tmp")]


@pytest.mark.parametrize(
    "changes",
    [
        {"cap_drop": []},
        {"user": "stampede"},
        {"volumes": [{"type": "bind", "source": "/", "target": "/host"}]},
        {"networks": {}},
        {"healthcheck": {"test": ["CMD-SHELL", "true"]}},
        {"stop_grace_period": "1 fortnight"},
    ],
)
def test_keys_that_the_proof_does_not_carry_out_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(plan.NotProvable):
        planned(**changes)


def test_services_start_after_their_dependencies() -> None:
    def waiting(*names: str) -> dict[str, Any]:
        return SERVICE | {"depends_on": {name: {"condition": "service_started"} for name in names}}

    project = {"services": {"a": waiting("c"), "b": waiting(), "c": waiting("b")}, "secrets": {}}
    assert plan.start_order(plan.plan_project(project, {"i": IMAGE}, "/v")) == ["b", "c", "a"]


def query(name: str, kind: int) -> bytes:
    labels = b"".join(bytes([len(label)]) + label.encode() for label in name.split("."))
    return struct.pack("!6H", 7, 0x0100, 1, 0, 0, 0) + labels + b"\0" + struct.pack("!2H", kind, 1)


@pytest.mark.parametrize(
    ("name", "kind", "code", "answers"),
    [("supernode-1", 1, 0, 1), ("SUPERNODE-1", 1, 0, 1), ("supernode-1", 28, 0, 0), ("elsewhere", 1, 3, 0)],
)
def test_the_name_server_knows_the_services_and_rejects_other_names_immediately(
    name: str, kind: int, code: int, answers: int
) -> None:
    response = name_server.answer(query(name, kind), {"supernode-1": "10.0.0.3"})
    number, flags, _, count, _, _ = struct.unpack_from("!6H", response)
    assert (number, flags & 0xF, count) == (7, code, answers)
    assert response.endswith(bytes([10, 0, 0, 3])) == bool(answers)


@pytest.mark.parametrize("junk", [b"", b"\0" * 5, query("a", 1)[:-3], struct.pack("!6H", 1, 0, 1, 0, 0, 0) + b"\x40a"])
def test_the_name_server_answers_no_junk(junk: bytes) -> None:
    assert name_server.answer(junk, {"a": "10.0.0.3"}) is None


OPTIONAL = {"opentelemetry"}  # the extra [otel]: the services use it only if it is installed


def imported_modules(folder: Path) -> Iterator[str]:
    """The top-level names of everything that the code below `folder` imports."""
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                yield from (alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                yield node.module.partition(".")[0]


def declared(package: str, extras: frozenset[str] = frozenset()) -> set[str]:
    """The distributions that `package` and `extras` name. If such a distribution is a package of this repository,
    the distributions that it names count, too.
    """
    project = tomllib.loads((PACKAGES[package] / "pyproject.toml").read_text())["project"]
    texts = [*project["dependencies"], *(text for extra in extras for text in project["optional-dependencies"][extra])]
    names = {re.split(r"[^\w-]", text, maxsplit=1)[0] for text in texts}
    return names.union(*(declared(name) for name in names if name in PACKAGES))


def extras_of_image(package: str) -> frozenset[str]:
    """The extras of `package` that each installation in its Dockerfile names."""
    file = ROOT / "deploy/docker" / f"{package.removeprefix('stampede-rt-')}.Dockerfile"
    if not file.exists():
        return frozenset()
    lines = [line for line in file.read_text().splitlines() if f"--package {package}" in line]
    return frozenset.intersection(*(frozenset(re.findall(r"--extra (\S+)", line)) for line in lines))


@pytest.mark.parametrize("package", sorted(set(PACKAGES) - {"stampede-rt"}))
def test_a_service_declares_its_imports_so_that_its_image_has_them(package: str) -> None:
    foreign = set(imported_modules(PACKAGES[package] / "src")) - sys.stdlib_module_names - OPTIONAL
    installed = importlib.metadata.packages_distributions()
    ours = {name.replace("-", "_"): [name] for name in PACKAGES}
    allowed = declared(package, extras_of_image(package)) | {package}
    providers = {module: ours.get(module) or installed.get(module, []) for module in foreign}
    # A distribution may write its name with "_" or "-"; both are the same name.
    named = {module: {name.replace("_", "-").lower() for name in names} for module, names in providers.items()}
    assert {module for module, names in named.items() if not allowed & names} == set()
