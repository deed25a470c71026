"""A bridge network as Compose makes it, and published ports, inside the network namespace that this process is in."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import subprocess
from collections.abc import Mapping
from typing import Any

BRIDGE = "cluster0"
FORWARD_BYTES_MAX = 64 * 2**10


def make_bridge(project: Mapping[str, Any]) -> str:
    """Make the project's network. This namespace plays the machine, and has the gateway's address.

    Returns this address.
    """
    (network,) = project["networks"].values()
    (config,) = network["ipam"]["config"]
    prefix = ipaddress.ip_network(config["subnet"]).prefixlen
    ip("link", "set", "lo", "up")
    # The bridge gets a fixed hardware address. Otherwise it takes a new one when a port is added or removed, and the
    # containers would lose the name server until they ask for its address again.
    ip("link", "add", BRIDGE, "address", _hardware_address(config["gateway"]), "type", "bridge")
    ip("addr", "add", f"{config['gateway']}/{prefix}", "dev", BRIDGE)
    ip("link", "set", BRIDGE, "up")
    return str(config["gateway"])


def plug_in(pid: int, link: str, address: str) -> None:
    """Give the network namespace of process `pid` an interface on the bridge, with `address`, and its loopback.

    `link` is a new name of 12 letters at most. The hardware address is computed from `address`. So other containers
    still find a container that is started again.
    """
    inner, outer = f"{link}-in", f"{link}-ex"
    ip("link", "add", outer, "type", "veth", "peer", "name", inner, "address", _hardware_address(address))
    ip("link", "set", outer, "master", BRIDGE, "up")
    ip("link", "set", inner, "netns", str(pid))
    for words in (
        ["link", "set", "lo", "up"],
        ["link", "set", inner, "name", "eth0"],
        ["addr", "add", f"{address}/24", "dev", "eth0"],
        ["link", "set", "eth0", "up"],
    ):
        subprocess.run(["nsenter", "--target", str(pid), "--net", "ip", *words], check=True)


def _hardware_address(address: str) -> str:
    return ":".join(f"{byte:02x}" for byte in (0x02, 0x42, *ipaddress.IPv4Address(address).packed))


def unplug(link: str) -> None:
    """Remove the interface `link`, if it still exists.

    After a process has died, the kernel removes its interface only after a while. Until then the old namespace would
    still have the address, and answer for it, although another one has started.
    """
    done = subprocess.run(["ip", "link", "delete", f"{link}-ex"], capture_output=True, text=True, check=False)
    if done.returncode != 0 and "Cannot find device" not in done.stderr:
        raise OSError(f"the interface {link} cannot be taken away: {done.stderr.strip()}")


def ip(*words: str) -> None:
    """Run `ip`. Raises CalledProcessError if it fails."""
    subprocess.run(["ip", *words], check=True)


async def publish(host: str, port: int, target: tuple[str, int]) -> asyncio.Server:
    """Listen at `host:port` and pass every connection on to `target`, as the engine's own proxy does."""

    async def forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            there = await asyncio.open_connection(*target)
        except OSError:
            writer.close()  # nothing listens there, so the caller's connection ends
            return
        await asyncio.gather(_pump(reader, there[1]), _pump(there[0], writer))

    return await asyncio.start_server(forward, host, port)


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    with contextlib.suppress(ConnectionError):  # either side may close first
        while data := await source.read(FORWARD_BYTES_MAX):
            sink.write(data)
            await sink.drain()
    sink.close()
