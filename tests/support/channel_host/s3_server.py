"""A real S3 server (versitygw, from the Go module proxy) as a process, for tests.

`python -m tests.support.channel_host.s3_server` builds it beforehand, which takes more than a minute of CPU time. The
program is therefore in the user's cache folder, where all checkouts find it.
"""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.polyglot.toolchains import GO_BUILD_FLAGS, ROOT, BuildFailed, Unavailable, step, tool

VERSION = "v1.8.0"
MODULE = f"github.com/versity/versitygw/cmd/versitygw@{VERSION}"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "stampede-rt" / f"versitygw-{VERSION}"
MODULES = ROOT / ".make" / "s3_server" / "modules"  # needed only for the build
BUCKET, ACCESS_KEY, SECRET_KEY = "archives", "tests", "secret-of-tests"
START_SECONDS_MAX = 20


def build() -> Path:
    """Build the program, unless this machine has it, and return its path. Raises Unavailable, BuildFailed."""
    program = CACHE / "versitygw"
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not program.exists():
            environment = {
                **os.environ,
                "GOBIN": str(CACHE / "new"),
                "GOMODCACHE": str(MODULES),
                "GOFLAGS": "-modcacherw",  # so that `make clean` can remove the modules
                "GOTOOLCHAIN": "local",
            }
            step([tool("go"), "install", *GO_BUILD_FLAGS, MODULE], ROOT, environment)
            (CACHE / "new" / "versitygw").replace(program)  # so the cache never has a part of the program
    return program


class S3Server:
    """One server with one bucket. `folder` has the objects as files. It can be stopped, frozen and started again."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.folder = folder / BUCKET
        self.folder.mkdir(parents=True)
        self._program, self._top = program, folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def environment(self) -> dict[str, str]:
        """The variables of a client."""
        return {
            "AWS_ACCESS_KEY_ID": ACCESS_KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET_KEY,
            "AWS_REGION": "us-east-1",
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{self._port}",
            "AWS_ALLOW_HTTP": "true",
        }

    def start(self) -> None:
        """Start the process, and wait until it takes connections."""
        credentials = {"ROOT_ACCESS_KEY": ACCESS_KEY, "ROOT_SECRET_KEY": SECRET_KEY}
        # some file systems have no extended attributes, so the metadata go to a separate folder
        command = [self._program, "--quiet", "--port", f"127.0.0.1:{self._port}", "posix"]
        sidecar = self._top.parent / f"metadata-of-{self._top.name}"
        sidecar.mkdir(exist_ok=True)
        self._process = subprocess.Popen(
            [*command, "--sidecar", str(sidecar), str(self._top)],
            env={**os.environ, **credentials},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        deadline = time.monotonic() + START_SECONDS_MAX
        while True:  # paced by the short wait for the process
            try:
                socket.create_connection(("127.0.0.1", self._port), timeout=1).close()
                return
            except OSError:
                if time.monotonic() > deadline:
                    raise
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(0.02)
                raise RuntimeError("the S3 server has ended")

    def stop(self) -> None:
        """Kill the process. Its objects stay."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def freeze(self, *, frozen: bool) -> None:
        """Let the process answer nothing, or go on."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP if frozen else signal.SIGCONT)


@contextmanager
def s3_server(folder: Path) -> Iterator[S3Server]:
    """A running server; skips the test, and says why, if it cannot be built here."""
    try:
        program = build()
    except Unavailable as reason:
        pytest.skip(f"no S3 server: {reason}")
    server = S3Server(program, folder)
    server.start()
    try:
        yield server
    finally:
        server.stop()


if __name__ == "__main__":
    try:
        build()
    except (Unavailable, BuildFailed) as failure:
        sys.exit(f"no S3 server: {failure}")
