"""Becomes one container: reads its plan from standard input, makes the file system, gives up every right, and runs it.

Started as process 1 of new namespaces (mount, network, pid, uts, ipc) by `container.py`, with the image's root folder
and an empty scratch folder as arguments.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NoReturn

DEVICES = ("null", "zero", "full", "random", "urandom")
PR_CAPBSET_DROP, PR_SET_NO_NEW_PRIVS = 24, 38  # from linux/prctl.h
_libc = ctypes.CDLL(None, use_errno=True)


def main() -> NoReturn:
    """Never returns: the service takes the process's place."""
    image_root, scratch = Path(sys.argv[1]), Path(sys.argv[2])
    plan: dict[str, Any] = json.load(sys.stdin)
    root = make_root(plan, image_root, scratch)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.chroot(root)
    os.chdir(plan["workdir"])
    give_up_rights(plan["uid"], plan["gid"], plan["groups"])
    os.execvpe(plan["argv"][0], plan["argv"], plan["env"])


def make_root(plan: dict[str, Any], image_root: Path, scratch: Path) -> Path:
    """The image with a layer of the container's own above it, and everything mounted that the plan names."""
    mount("--make-rprivate", "/")
    mount("-t", "tmpfs", "tmpfs", str(scratch))
    upper, work, root = (scratch / name for name in ("upper", "work", "root"))
    for folder in (upper, work, root):
        folder.mkdir()
    mount("-t", "overlay", "-o", f"lowerdir={image_root},upperdir={upper},workdir={work}", "overlay", str(root))
    mount("-t", "proc", "proc", str(root / "proc"))
    mount_devices(root)
    for name, content in plan["files"].items():
        inside(root, name).write_text(content)
    targets = [mount_one(root, *entry) for entry in plan["mounts"]]
    subprocess.run(["hostname", plan["service"]], check=True)
    if plan["read_only"]:
        mount("-o", "remount,ro", str(root))  # this one alone: what is mounted below it keeps its own rights
    assert all(target.exists() for target in targets)
    return root


def mount_devices(root: Path) -> None:
    """The few devices that every container has."""
    mount("-t", "tmpfs", "-o", "mode=755", "tmpfs", str(root / "dev"))
    for name in DEVICES:
        (root / "dev" / name).touch()
        mount("--bind", f"/dev/{name}", str(root / "dev" / name))
    (root / "dev/shm").mkdir()
    mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", str(root / "dev/shm"))


def mount_one(root: Path, kind: str, source: str, target: str) -> Path:
    """One entry of the plan's mounts; returns the place that it is at."""
    place = inside(root, target)
    if kind == "tmpfs":
        place.mkdir(parents=True, exist_ok=True)
        mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", str(place))
        return place
    if Path(source).is_dir():
        place.mkdir(parents=True, exist_ok=True)
    else:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
    mount("--bind", source, str(place))
    if kind == "ro":
        mount("-o", "remount,bind,ro", str(place))
    return place


def inside(root: Path, target: str) -> Path:
    """`target`, as the container names it, in its root."""
    return root / target.lstrip("/")


def give_up_rights(uid: int, gid: int, groups: list[int]) -> None:
    """No capability can be held or gained any more, and the user is the plan's."""
    last = int(Path("/proc/sys/kernel/cap_last_cap").read_text())
    for capability in range(last + 1):
        prctl(PR_CAPBSET_DROP, capability)
    prctl(PR_SET_NO_NEW_PRIVS, 1)
    os.setgroups(groups)
    os.setgid(gid)
    os.setuid(uid)


def prctl(option: int, value: int) -> None:
    """Raises OSError if the kernel refuses."""
    if _libc.prctl(option, value, 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl {option} {value}: {os.strerror(number)}")


def mount(*arguments: str) -> None:
    """Raises CalledProcessError if it is refused."""
    subprocess.run(["mount", *arguments], check=True)


if __name__ == "__main__":
    main()
