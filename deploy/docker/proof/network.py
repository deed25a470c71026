"""Makes a bridge network as Compose does, and publishes ports, inside the network namespace of this process."""

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
    """Make the project's network, and return the address of its gateway.

    The bridge in this namespace gets that address, as the machine does under Docker.
    """
    (network,) = project["networks"].values()
    (config,) = network["ipam"]["config"]
    prefix = ipaddress.ip_network(config["subnet"]).prefixlen
    ip("link", "set", "lo", "up")
    # The bridge gets a fixed hardware address. Otherwise the address would change when an interface joins or leaves the
    # bridge, and the containers would not reach the name server until they ask for the bridge's address again.
    ip("link", "add", BRIDGE, "address", _hardware_address(config["gateway"]), "type", "bridge")
    ip("addr", "add", f"{config['gateway']}/{prefix}", "dev", BRIDGE)
    ip("link", "set", BRIDGE, "up")
    return str(config["gateway"])


def plug_in(pid: int, link: str, address: str) -> None:
    """Connect the network namespace of process `pid` to the bridge with `address`, and start its loopback interface.

    `link` is a new name for the connection, of 12 characters at most. The hardware address is computed from `address`.
    So a container that is started again keeps its hardware address, and other containers still find it.
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
    """Remove the connection `link` that `plug_in` made, if it still exists. Raises OSError if `ip` fails.

    After a container has died, the kernel removes its interface only after a while. Until then the dead container's
    namespace would still answer for the address, although a new container with this address has started.
    """
    done = subprocess.run(["ip", "link", "delete", f"{link}-ex"], capture_output=True, text=True, check=False)
    if done.returncode != 0 and "Cannot find device" not in done.stderr:
        raise OSError(f"the interface {link}-ex cannot be removed: {done.stderr.strip()}")


def ip(*words: str) -> None:
    """Run `ip`. Raises CalledProcessError if it fails."""
    subprocess.run(["ip", *words], check=True)


async def publish(host: str, port: int, target: tuple[str, int]) -> asyncio.Server:
    """Listen at `host:port` and pass every connection on to `target`, as Docker's proxy does."""

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
