"""The folder in which `stampede dev` keeps the directory of its cluster, so that the next start finds the channels."""

from __future__ import annotations

import json
import os
from pathlib import Path

from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceFailed
from stampede_rt_runtime.values import Address, parse_address

_MEMBERS = "members.json"


def members_in(folder: Path, count: int, host: str) -> dict[str, str]:
    """Return the addresses of `count` supernodes at `host`, by their ids.

    A supernode never changes its address. So the folder keeps the addresses of the first start, which got free ports.
    Raises ServiceFailed if the folder has the directory of other supernodes, and OSError.
    """
    path = folder / _MEMBERS
    if not path.exists():
        ports = free_ports(count, host)
        members = {f"s{number}": str(Address(host, port)) for number, port in enumerate(ports, start=1)}
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        draft = path.with_suffix(".draft")
        with draft.open("w") as file:
            file.write(json.dumps(members))
            file.flush()
            os.fsync(file.fileno())
        draft.rename(path)
        return members
    try:
        members = {str(name): str(parse_address(address)) for name, address in json.loads(path.read_text()).items()}
    except (ValueError, AttributeError) as error:
        raise ServiceFailed(f"{path} is damaged: {error}; remove the folder {folder}, and with it all names") from error
    hosts = {parse_address(one).host for one in members.values()}
    if len(members) != count or hosts != {host}:
        raise ServiceFailed(
            f"{folder} has a directory for --supernodes {len(members)} at {', '.join(sorted(hosts))}; start with "
            f"--supernodes {len(members)} and that host in --listen, or choose another folder for the archive"
        )
    return members


def check_hosts(folder: Path, hosts: int) -> None:
    """Check that the archives beside the directory are of `hosts` hosts at most. Raises ServiceFailed.

    If a host with an archive were missing, another one would take its channels over, without its archive.
    """
    if (folder.parent / f"h{hosts + 1}").exists():
        raise ServiceFailed(
            f"{folder.parent} has archives of more hosts than {hosts}; start with --hosts as before, or choose another "
            "folder for the archive"
        )
