"""Merges the compose project and the settings of the images into one plan for each service. Pure.

`project` is the compose file as the reference parser prints it; `image` is the `Config` of `podman image inspect`. The
Compose specification has the rules for the merge: settings of the file override settings of the image.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

_SECONDS = re.compile(r"(?:(\d+)m)?(?:(\d+(?:\.\d+)?)s)?")


class NotProvable(Exception):
    """The compose file has a setting that this proof does not support; the text names it."""


@dataclass(frozen=True, kw_only=True)
class ContainerPlan:
    """One container. `argv` and `env` are complete; `mounts` are (kind, source, target), kind being bind, ro or tmpfs.

    `waits_for` is service -> condition; `published` is (address of the machine, its port, the container's port).
    """

    service: str
    image: str
    argv: list[str]
    env: dict[str, str]
    uid: int
    gid: int
    groups: list[int]
    workdir: str
    read_only: bool
    mounts: list[tuple[str, str, str]]
    address: str
    published: list[tuple[str, int, int]]
    waits_for: dict[str, str]
    health: list[str]
    stop_seconds: float
    memory_bytes_max: int
    tasks_max: int

    def as_json(self) -> dict[str, Any]:
        """Return the plan for the process that becomes the container."""
        return asdict(self)


def plan_project(
    project: Mapping[str, Any], images: Mapping[str, Mapping[str, Any]], volumes_folder: str
) -> dict[str, ContainerPlan]:
    """Return a plan for every service of the project. Named volumes are folders in `volumes_folder`.

    Raises NotProvable.
    """
    services: Mapping[str, Mapping[str, Any]] = project["services"]
    return {
        name: _plan_service(name, service, project, images[service["image"]], volumes_folder)
        for name, service in services.items()
    }


def start_order(plans: Mapping[str, ContainerPlan]) -> list[str]:
    """Return the services, each after all its dependencies. (The reference parser refuses cycles.)"""
    order: list[str] = []

    def visit(name: str) -> None:
        for earlier in sorted(plans[name].waits_for):
            visit(earlier)
        if name not in order:
            order.append(name)

    for name in sorted(plans):
        visit(name)
    return order


def _plan_service(
    name: str, service: Mapping[str, Any], project: Mapping[str, Any], image: Mapping[str, Any], volumes_folder: str
) -> ContainerPlan:
    uid, gid = _user(service.get("user") or image.get("User") or "0:0")
    limits = service.get("deploy", {}).get("resources", {}).get("limits", {})
    if service.get("cap_drop") != ["ALL"] or "no-new-privileges:true" not in service.get("security_opt", []):
        raise NotProvable(f"{name}: only containers without capabilities and new privileges are proved here")
    return ContainerPlan(
        service=name,
        image=service["image"],
        argv=_argv(name, service, image),
        env=_environment(service, image),
        uid=uid,
        gid=gid,
        groups=[int(group) for group in service.get("group_add", [])],
        workdir=service.get("working_dir") or image.get("WorkingDir") or "/",
        read_only=bool(service.get("read_only")),
        mounts=list(_mounts(name, service, project, volumes_folder)),
        address=_address(name, service),
        published=[_published(name, port) for port in service.get("ports", [])],
        waits_for={other: entry["condition"] for other, entry in service.get("depends_on", {}).items()},
        health=_health(name, service),
        stop_seconds=seconds(service.get("stop_grace_period", "10s")),
        memory_bytes_max=int(limits["memory"]),
        tasks_max=int(limits["pids"]),
    )


def _argv(name: str, service: Mapping[str, Any], image: Mapping[str, Any]) -> list[str]:
    entrypoint = service.get("entrypoint")
    command = service.get("command")
    if entrypoint is None:
        entrypoint = image.get("Entrypoint") or []
        command = (image.get("Cmd") or []) if command is None else command
    argv = [*entrypoint, *(command or [])]
    if not argv:
        raise NotProvable(f"{name}: neither the image nor the compose file says what to run")
    return argv


def _environment(service: Mapping[str, Any], image: Mapping[str, Any]) -> dict[str, str]:
    env = dict(entry.split("=", 1) for entry in image.get("Env", []))
    env.update({key: value for key, value in service.get("environment", {}).items() if value is not None})
    return env


def _user(text: str) -> tuple[int, int]:
    uid, _, gid = text.partition(":")
    if not (uid.isdigit() and gid.isdigit()):
        raise NotProvable(f"the user {text!r} is not UID:GID in numbers")
    return int(uid), int(gid)


def _mounts(
    name: str, service: Mapping[str, Any], project: Mapping[str, Any], volumes_folder: str
) -> Iterator[tuple[str, str, str]]:
    for target in service.get("tmpfs", []):
        yield "tmpfs", "", target
    for secret in service.get("secrets", []):
        target = secret.get("target") or secret["source"]
        place = target if target.startswith("/") else f"/run/secrets/{target}"
        yield "ro", project["secrets"][secret["source"]]["file"], place
    for volume in service.get("volumes", []):
        if volume["type"] != "volume":
            raise NotProvable(f"{name}: a mount of type {volume['type']!r}")
        yield "bind", f"{volumes_folder}/{volume['source']}", volume["target"]


def _address(name: str, service: Mapping[str, Any]) -> str:
    networks = service.get("networks", {})
    if len(networks) != 1:
        raise NotProvable(f"{name}: {len(networks)} networks; this proof supports one")
    (network,) = networks.values()
    return str(network["ipv4_address"])


def _published(name: str, port: Mapping[str, Any]) -> tuple[str, int, int]:
    if port.get("protocol", "tcp") != "tcp":
        raise NotProvable(f"{name}: a published port of protocol {port['protocol']!r}")
    return port.get("host_ip", "0.0.0.0"), int(port["published"]), int(port["target"])


def _health(name: str, service: Mapping[str, Any]) -> list[str]:
    test: list[str] = service.get("healthcheck", {}).get("test", [])
    if test[:1] != ["CMD"]:
        raise NotProvable(f"{name}: a health check that is not in the form [CMD, ...]")
    return test[1:]


def seconds(text: str) -> float:
    """Return the seconds of a duration of the Compose specification; only minutes and seconds. Raises NotProvable."""
    match = _SECONDS.fullmatch(text)
    if match is None or not text:
        raise NotProvable(f"the duration {text!r}")
    return 60 * float(match[1] or 0) + float(match[2] or 0)
