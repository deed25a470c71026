"""One container: starts it from its plan, checks its health, inspects it, and stops it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import network
from plan import ContainerPlan

FORK_SECONDS = 5.0
HEALTH_SECONDS, HEALTH_EVERY_SECONDS = 60.0, 0.3
_NAMESPACES = ["--mount", "--net", "--pid", "--uts", "--ipc"]
_ENTER = Path(__file__).with_name("enter.py")


class ProofFailed(Exception):
    """The containers did not behave as the compose file says. The text names the difference."""


class Container:
    """One container. Call `start`, `wait_healthy` and `stop` in this order, and `kill` at any time.

    `log` has its whole output.
    """

    def __init__(self, plan: ContainerPlan, number: int, image_root: str, name_server: str, log: Path) -> None:
        self.plan = plan
        self.log = log
        self._number = number
        self._starts = 0
        self._image_root = image_root
        self._files = {
            "/etc/hosts": f"127.0.0.1 localhost\n::1 localhost\n{plan.address} {plan.service}\n",
            "/etc/resolv.conf": f"nameserver {name_server}\noptions ndots:0\n",
            "/etc/hostname": f"{plan.service}\n",
        }
        self._launcher: subprocess.Popen[bytes] | None = None
        self.pid = 0

    def start(self) -> None:
        """Start the container in new namespaces, and connect it to the bridge. Raises ProofFailed."""
        scratch = tempfile.mkdtemp(prefix="container-", dir=self.log.parent)
        command = ["unshare", *_NAMESPACES, "--fork", "--kill-child", sys.executable, "-I", str(_ENTER)]
        with self.log.open("ab") as log:
            self._launcher = subprocess.Popen(
                [*command, self._image_root, scratch], stdin=subprocess.PIPE, stdout=log, stderr=log
            )
        self.pid = self._first_process()
        network.unplug(self._link())
        self._starts += 1
        network.plug_in(self.pid, self._link(), self.plan.address)
        stdin = self._launcher.stdin
        assert stdin is not None
        with stdin:
            stdin.write(json.dumps(self.plan.as_json() | {"files": self._files}).encode())

    def _first_process(self) -> int:
        """Return this namespace's process id of the container's process 1.

        When it exists, its namespaces exist, too.
        """
        launcher = self._running()
        children = Path(f"/proc/{launcher.pid}/task/{launcher.pid}/children")
        deadline = time.monotonic() + FORK_SECONDS
        while time.monotonic() < deadline and launcher.poll() is None:
            if found := children.read_text().split():
                return int(found[0])
            time.sleep(0.01)
        raise ProofFailed(f"{self.plan.service} did not start; {self.story()}")

    def wait_healthy(self) -> float:
        """Run the health check until it succeeds; returns the seconds that it took. Raises ProofFailed."""
        began = time.monotonic()
        output = "the health check never ran"
        while time.monotonic() - began < HEALTH_SECONDS:
            if self.exit_code is not None:
                raise ProofFailed(f"{self.plan.service} ended with code {self.exit_code}; {self.story()}")
            healthy, output = self.check_health()
            if healthy:
                return time.monotonic() - began
            time.sleep(HEALTH_EVERY_SECONDS)
        raise ProofFailed(f"{self.plan.service} is not healthy: {output}; {self.story()}")

    def check_health(self) -> tuple[bool, str]:
        """Run the command of the health check in the container, as its user.

        Returns whether it succeeded, and its output.
        """
        done = self.run(self.plan.health)
        return done.returncode == 0, (done.stdout + done.stderr).strip()

    def run(self, argv: list[str]) -> subprocess.CompletedProcess[str]:
        """Run a command in the container as its user, with its environment and root, as `docker exec` does."""
        enter = ["nsenter", f"--target={self.pid}", *_NAMESPACES, f"--root=/proc/{self.pid}/root"]
        user = [f"--setuid={self.plan.uid}", f"--setgid={self.plan.gid}", f"--wdns={self.plan.workdir}"]
        env = [f"{key}={value}" for key, value in self.plan.env.items()]
        command = [*enter, *user, "--", "/usr/bin/env", "-i", *env, *argv]
        return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)

    def facts(self) -> dict[str, str]:
        """Return the kernel's facts about process 1: user, groups, capabilities, peak of memory, threads."""
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return {key: value.strip() for key, _, value in (line.partition(":") for line in lines)}

    def stop(self) -> float:
        """Send SIGTERM to process 1, and wait as long as the file allows. Returns the seconds. Raises ProofFailed."""
        launcher = self._running()
        began = time.monotonic()
        self.signal(signal.SIGTERM)
        try:
            code = launcher.wait(self.plan.stop_seconds)
        except subprocess.TimeoutExpired:
            raise ProofFailed(f"{self.plan.service} did not stop in {self.plan.stop_seconds} s") from None
        if code != 0:
            raise ProofFailed(f"{self.plan.service} stopped with code {code}; {self.story()}")
        return time.monotonic() - began

    def kill(self) -> None:
        """End the container with SIGKILL if it still runs. On return its process has ended, and its locks are free."""
        if self._launcher is None or self.exit_code is not None:
            return
        if self.pid:
            self.signal(signal.SIGKILL)  # the launcher ends after its child
        else:
            self._launcher.kill()
        self._launcher.wait()

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to process 1."""
        subprocess.run(["kill", f"-{number}", str(self.pid)], check=True)

    @property
    def started(self) -> bool:
        """Whether the container was ever started."""
        return self._launcher is not None

    @property
    def exit_code(self) -> int | None:
        """The exit status of the container; None while it runs."""
        return self._running().poll()

    def story(self) -> str:
        """Return the last lines of the container's output, for an error text."""
        return "its last lines:\n" + "\n".join(self.log.read_text(errors="replace").splitlines()[-20:])

    def _link(self) -> str:
        return f"c{self._number}s{self._starts}"

    def _running(self) -> subprocess.Popen[bytes]:
        if self._launcher is None:
            raise ProofFailed(f"{self.plan.service} was never started")
        return self._launcher
