"""Prepares the clients of other languages. Their tools and packages come from the languages' own registries.

Everything is kept below `.make/polyglot`, so that only the first run needs the network. Only Go's build cache is the
user's own: it often has the standard library already, and all checkouts share it. A missing toolchain or an unreachable
registry raises `Unavailable`, every other failure `BuildFailed`.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROTO = ROOT / "proto"
SOURCES = Path(__file__).resolve().parent
CACHE = ROOT / ".make" / "polyglot"
STEP_SECONDS_MAX = 240.0

GO_PLUGINS = (
    "google.golang.org/protobuf/cmd/protoc-gen-go@v1.36.11",
    "google.golang.org/grpc/cmd/protoc-gen-go-grpc@v1.6.0",
)
GO_PACKAGE = "stampede-rt.example/polyglot/v1"
GO_BUILD_FLAGS = (
    "-trimpath",  # without the paths of this checkout, so that the build cache serves other checkouts, too
    "-gcflags=google.golang.org/...=-N -l",  # an optimised gRPC takes longer to compile than to run
)

# The words of Go and npm when they cannot reach a registry. A wrong version or checksum has other words, and is a
# failure.
NO_WAY_THROUGH = re.compile(
    r"dial tcp|no such host|connection refused|i/o timeout|TLS handshake timeout|network is unreachable"
    r"|module lookup disabled by GOPROXY=off"
    r"|ENOTFOUND|ECONNREFUSED|ECONNRESET|EAI_AGAIN|ETIMEDOUT|ENETUNREACH|ERR_SOCKET_TIMEOUT|ENOTCACHED"
)


class Unavailable(Exception):
    """This machine cannot run the client. The text says why. A reason to skip a test."""


class BuildFailed(Exception):
    """The client, the contract or a pinned version is wrong. A reason to fail."""


@dataclass(frozen=True, kw_only=True)
class Client:
    """A client that is ready: `command` is followed by ADDRESS SECRET_FILE CHANNEL TEXT..."""

    language: str
    command: tuple[str, ...]
    environment: dict[str, str]

    def run(self, *arguments: str, timeout: float = 30.0) -> subprocess.CompletedProcess[str]:
        """Run it to its end. Raises subprocess.TimeoutExpired."""
        return subprocess.run(
            [*self.command, *arguments],
            capture_output=True,
            text=True,
            timeout=timeout,
            env=self.environment,
            check=False,
        )


def tool(name: str) -> str:
    """The path of a program. Raises Unavailable."""
    path = shutil.which(name)
    if path is None:
        raise Unavailable(f"{name} is not installed on this machine")
    return path


def step(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    """Run one step of a build. Raises Unavailable if a registry cannot be reached, BuildFailed for other failures."""
    shown = " ".join(command[:4])
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=STEP_SECONDS_MAX,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise Unavailable(f"`{shown}` was not done within {STEP_SECONDS_MAX:.0f} s") from error
    output = done.stdout + done.stderr
    if done.returncode == 0:
        return
    reasons = [line for line in output.splitlines() if NO_WAY_THROUGH.search(line)]
    if reasons:
        raise Unavailable(f"`{shown}` cannot reach its package registry: {reasons[0].strip()}")
    raise BuildFailed(f"`{shown}` failed:\n{output}")


def once(stamp: Path, key: str) -> bool:
    """Whether the files of `key` still must be fetched.

    A caller that gets True writes `key` into the stamp afterwards.
    """
    return not (stamp.is_file() and stamp.read_text() == key)


def digest(*texts: str) -> str:
    """A short hash of all texts on which a fetch depends."""
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


def prepare_go() -> Client:
    """Fetch the plugins, generate the stubs from proto/, build the client. Raises Unavailable, BuildFailed."""
    go = tool("go")
    home = CACHE / "go"
    work = home / "client"
    work.mkdir(parents=True, exist_ok=True)
    for name in ("main.go", "go.mod", "go.sum"):
        shutil.copyfile(SOURCES / "go" / name, work / name)
    environment = {
        **os.environ,
        "GOBIN": str(home / "bin"),
        "GOMODCACHE": str(home / "modules"),
        "GOFLAGS": "-modcacherw",  # so that `make clean` can remove the modules
        "GOTOOLCHAIN": "local",
    }
    stamp, key = home / "fetched", digest(*GO_PLUGINS)
    if once(stamp, key):
        for plugin in GO_PLUGINS:
            step([go, "install", *GO_BUILD_FLAGS, plugin], work, environment)
        stamp.write_text(key)
    generate_go(home / "bin", work, environment)
    step([go, "build", *GO_BUILD_FLAGS, "-o", "client", "."], work, environment)
    return Client(language="go", command=(str(work / "client"),), environment=dict(os.environ))


def generate_go(plugins: Path, work: Path, environment: dict[str, str]) -> None:
    """Write the Go stubs of every .proto to `work`/v1. The .proto files name no Go package: the command does."""
    shutil.rmtree(work / "v1", ignore_errors=True)
    sources = sorted(str(path.relative_to(PROTO)) for path in PROTO.rglob("*.proto"))
    module = GO_PACKAGE.rpartition("/")[0]
    command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{PROTO}"]
    for plugin in ("go", "go-grpc"):
        command += [f"--plugin=protoc-gen-{plugin}={plugins / f'protoc-gen-{plugin}'}", f"--{plugin}_out={work}"]
        command += [f"--{plugin}_opt=module={module}", *(f"--{plugin}_opt=M{name}={GO_PACKAGE}" for name in sources)]
    step([*command, *sources], work, environment)


def prepare_node() -> Client:
    """Fetch the packages; there is nothing to generate or build. Raises Unavailable, BuildFailed."""
    node, npm = tool("node"), tool("npm")
    home = CACHE / "node"
    home.mkdir(parents=True, exist_ok=True)
    for name in ("client.js", "package.json", "package-lock.json"):
        shutil.copyfile(SOURCES / "node" / name, home / name)
    stamp, key = home / "fetched", digest((home / "package-lock.json").read_text())
    if once(stamp, key):
        quiet = ["--ignore-scripts", "--no-audit", "--no-fund", "--fetch-retries=1"]
        step([npm, "ci", *quiet, "--cache", str(home / "cache")], home, dict(os.environ))
        stamp.write_text(key)
    return Client(language="node", command=(node, str(home / "client.js"), str(PROTO)), environment=dict(os.environ))


PREPARE = {"go": prepare_go, "node": prepare_node}
