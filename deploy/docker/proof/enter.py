"""Becomes one container: reads the plan from standard input, makes the file system, drops all rights, runs the service.

`container.py` starts it as process 1 of new namespaces (mount, network, pid, uts, ipc). The arguments are the image's
root folder and an empty scratch folder.
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
    """Run the service in place of this process. Never returns."""
    image_root, scratch = Path(sys.argv[1]), Path(sys.argv[2])
    plan: dict[str, Any] = json.load(sys.stdin)
    root = make_root(plan, image_root, scratch)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.chroot(root)
    os.chdir(plan["workdir"])
    give_up_rights(plan["uid"], plan["gid"], plan["groups"])
    os.execvpe(plan["argv"][0], plan["argv"], plan["env"])


def make_root(plan: dict[str, Any], image_root: Path, scratch: Path) -> Path:
    """Make the root: the image with a separate layer for the container above it, and all mounts of the plan."""
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
        mount("-o", "remount,ro", str(root))  # only this mount; the mounts below it keep their own rights
    assert all(target.exists() for target in targets)
    return root


def mount_devices(root: Path) -> None:
    """Mount the few devices that every container has."""
    mount("-t", "tmpfs", "-o", "mode=755", "tmpfs", str(root / "dev"))
    for name in DEVICES:
        (root / "dev" / name).touch()
        mount("--bind", f"/dev/{name}", str(root / "dev" / name))
    (root / "dev/shm").mkdir()
    mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", str(root / "dev/shm"))


def mount_one(root: Path, kind: str, source: str, target: str) -> Path:
    """Make one mount of the plan. Returns its path."""
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
    """Return the path below `root` of `target`, a path inside the container."""
    return root / target.lstrip("/")


def give_up_rights(uid: int, gid: int, groups: list[int]) -> None:
    """Drop all capabilities permanently, and become the user of the plan."""
    last = int(Path("/proc/sys/kernel/cap_last_cap").read_text())
    for capability in range(last + 1):
        prctl(PR_CAPBSET_DROP, capability)
    prctl(PR_SET_NO_NEW_PRIVS, 1)
    os.setgroups(groups)
    os.setgid(gid)
    os.setuid(uid)


def prctl(option: int, value: int) -> None:
    """Call prctl. Raises OSError if the kernel refuses."""
    if _libc.prctl(option, value, 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"prctl {option} {value}: {os.strerror(number)}")


def mount(*arguments: str) -> None:
    """Run `mount`. Raises CalledProcessError if it fails."""
    subprocess.run(["mount", *arguments], check=True)


if __name__ == "__main__":
    main()
