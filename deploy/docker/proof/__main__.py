"""Runs a compose project without a container engine, from its real images, and checks its promises.

    unshare --net --mount --pid --mount-proc --fork \\
        python deploy/docker/proof --project project.json --images images.json --work FOLDER

`project.json` is the output of compose_check; `images.json` maps each image to its `root` folder and `config`. Run it
as root, in new namespaces: this process plays the machine, and every container gets namespaces below it. Prints one
line for each successful check. At the first failed check it prints the reason; the exit status is 1.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import network
from container import Container, ProofFailed
from name_server import serve_names
from plan import ContainerPlan, NotProvable, plan_project, start_order

PROGRAM = Path(__file__).with_name("put_and_get.py")
README = Path(__file__).parents[3] / "README.md"
PROGRAM_SECONDS = 60.0
EXPECTED = ["newest: b'three'", "last 30 s: [b'one', b'two', b'three']"]
_BEGAN = time.monotonic()


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description="see the head of this file")
    for name in ("project", "images", "work"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    given = parser.parse_args()
    project, images = json.loads(given.project.read_text()), json.loads(given.images.read_text())
    try:
        prove(project, images, given.work)
    except (ProofFailed, NotProvable) as error:
        sys.stderr.write(f"NOT PROVED: {error}\n")
        return 1
    return 0


def prove(project: Mapping[str, Any], images: Mapping[str, Mapping[str, Any]], work: Path) -> None:
    """Run the whole proof. Raises ProofFailed or NotProvable. Ends all containers."""
    configs = {name: image["config"] for name, image in images.items()}
    plans = plan_project(project, configs, str(work / "volumes"))
    make_volumes(plans, images)
    gateway = network.make_bridge(project)
    containers = {
        name: Container(plan, number, images[plan.image]["root"], gateway, work / f"{name}.log")
        for number, (name, plan) in enumerate(sorted(plans.items()))
    }
    secret = Path(next(iter(project["secrets"].values()))["file"])
    try:
        with engine_services(plans, gateway):
            use(containers, start_order(plans), secret)
    except ProofFailed as failure:
        raise ProofFailed("\n".join([str(failure), *ends(containers)])) from failure
    finally:
        for container in containers.values():
            container.kill()


def ends(containers: Mapping[str, Container]) -> Iterator[str]:
    """Yield the last output of all ended containers, because the reason for a failure is often in another container."""
    for name, container in containers.items():
        if container.started and container.exit_code is not None:
            yield f"{name} ended with code {container.exit_code}; {container.story()}"


def use(containers: Mapping[str, Container], order: list[str], secret: Path) -> None:
    """Run all checks between start and stop, in the order in which an operator would do these steps."""
    start(containers, order)
    for container in containers.values():
        check_rights(container, secret.read_text().strip())
    run_readme_program(secret)
    check_refusal(secret.parent)
    survive_deaths(containers, secret)
    for container in containers.values():
        check_limits(container)
    for name in reversed(order):
        print_result(f"{name} stopped by SIGTERM with exit code 0 after {containers[name].stop():.1f} s")


def make_volumes(plans: Mapping[str, ContainerPlan], images: Mapping[str, Mapping[str, Any]]) -> None:
    """Make the named volumes. Each begins as a copy of the image's folder at its place, with owner and mode."""
    for plan in plans.values():
        for kind, source, target in plan.mounts:
            if kind == "bind":
                Path(source).parent.mkdir(parents=True, exist_ok=True)
                subprocess.run(["cp", "--archive", images[plan.image]["root"] + target, source], check=True)


@contextmanager
def engine_services(plans: Mapping[str, ContainerPlan], gateway: str) -> Iterator[None]:
    """Do the work of an engine for a network while the block runs, on a thread: resolve names and publish ports."""
    loop = asyncio.new_event_loop()

    async def listen() -> None:
        await serve_names(gateway, {plan.service: plan.address for plan in plans.values()})
        for plan in plans.values():
            for host, port, inner in plan.published:
                await network.publish(host, port, (plan.address, inner))

    loop.run_until_complete(listen())
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()
    try:
        yield
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()


def start(containers: Mapping[str, Container], order: list[str]) -> None:
    """Start each container when the conditions of its dependencies hold. Then wait until all are healthy."""
    healthy: set[str] = set()
    for name in order:
        for earlier, condition in containers[name].plan.waits_for.items():
            if condition == "service_healthy" and earlier not in healthy:
                print_result(f"{earlier} is healthy after {containers[earlier].wait_healthy():.1f} s")
                healthy.add(earlier)
        containers[name].start()
        print_result(f"{name} started: {' '.join(containers[name].plan.argv)}")
    for name in sorted(set(containers) - healthy):
        print_result(f"{name} is healthy after {containers[name].wait_healthy():.1f} s")


def check_rights(container: Container, secret: str) -> None:
    """Check the user, its rights, and the secret.

    The user is the user of the image, without capabilities. Nobody can change the image. The secret is only in its
    file.
    """
    facts, plan = container.facts(), container.plan
    require(facts["Uid"].split() == [str(plan.uid)] * 4 and plan.uid != 0, f"{plan.service} runs as {facts['Uid']}")
    require(int(facts["CapEff"], 16) == int(facts["CapBnd"], 16) == 0, f"{plan.service} has capabilities")
    require(facts["NoNewPrivs"] == "1", f"{plan.service} can gain privileges")
    require(container.run(["touch", "/opt/stampede/new"]).returncode != 0, f"{plan.service} can change its image")
    environment = Path(f"/proc/{container.pid}/environ").read_bytes()
    require(secret.encode() not in environment, f"{plan.service} has the secret in its environment")
    print_result(f"{plan.service} runs as user {plan.uid} without capabilities, on a root that it cannot write")


def run_readme_program(secret: Path) -> None:
    """Run the first program of the README unchanged, outside all containers, against the published port."""
    block = re.search(r"^```python\n(.*?)^```$", README.read_text(), re.MULTILINE | re.DOTALL)
    if block is None or "st.connect(" not in block[1]:
        raise ProofFailed(f"{README} does not begin with a program that connects")
    done = client(["-c", block[1]], {"STAMPEDE_SECRET_FILE": str(secret)})
    require(done.returncode == 0, f"the first program of the README failed:\n{done.stdout}{done.stderr}")
    require(done.stdout.count("frame") >= 2, f"the first program of the README printed:\n{done.stdout}")
    print_result("the first program of the README, run on the machine, printed:")
    sys.stdout.write("".join(f"           | {line}\n" for line in done.stdout.splitlines()))


def run_program(channel: str, secret: Path) -> None:
    """Run a similar program on another channel, and compare its whole output."""
    done = client([str(PROGRAM), channel], {"STAMPEDE_SECRET_FILE": str(secret)})
    require(done.returncode == 0, f"the program failed:\n{done.stdout}{done.stderr}")
    require(done.stdout.splitlines() == EXPECTED, f"the program printed:\n{done.stdout}")
    print_result(f"a program on {channel} printed: " + "; ".join(EXPECTED))


def check_refusal(folder: Path) -> None:
    """Check that a program without the right secret is refused."""
    wrong = folder / "another-secret"
    wrong.write_text("not the secret of this cluster\n")
    wrong.chmod(0o600)
    done = client([str(PROGRAM)], {"STAMPEDE_SECRET_FILE": str(wrong)})
    require(done.returncode != 0 and "PermissionDenied" in done.stderr, f"another secret was accepted:\n{done.stderr}")
    print_result("a program that brings another secret is refused with PermissionDenied")


def survive_deaths(containers: Mapping[str, Container], secret: Path) -> None:
    """Kill one supernode after the other, also the leader.

    Check that programs go on, and that each comes back with its volume.
    """
    for name in (name for name in containers if name.startswith("supernode-")):
        containers[name].kill()
        run_program(f"cam/without-{name}", secret)
        containers[name].start()
        seconds = containers[name].wait_healthy()
        print_result(f"{name}, killed meanwhile, was started again and is healthy after {seconds:.1f} s")


def check_limits(container: Container) -> None:
    """Check that the limits of the file are far above the use of an idle service.

    A lower limit would kill the service immediately.
    """
    facts, plan = container.facts(), container.plan
    peak, tasks = int(facts["VmHWM"].split()[0]) * 1024, int(facts["Threads"])
    require(2 * peak < plan.memory_bytes_max, f"{plan.service} used {peak} of {plan.memory_bytes_max} bytes")
    require(2 * tasks < plan.tasks_max, f"{plan.service} has {tasks} of {plan.tasks_max} tasks")
    allowed = plan.memory_bytes_max // 2**20
    print_result(f"{plan.service} used {peak // 2**20} of {allowed} MiB and {tasks} of {plan.tasks_max} tasks at most")


def client(words: list[str], env: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a Python program on the machine, with this interpreter. Of our settings it gets only `env`."""
    outer = {key: value for key, value in os.environ.items() if not key.startswith("STAMPEDE_")}
    command = [sys.executable, *words]
    return subprocess.run(
        command, env=outer | dict(env), capture_output=True, text=True, timeout=PROGRAM_SECONDS, check=False
    )


def require(holds: bool, otherwise: str) -> None:
    """Raise ProofFailed with `otherwise` if the condition does not hold."""
    if not holds:
        raise ProofFailed(otherwise)


def print_result(line: str) -> None:
    """Print one result, with the time since the start."""
    sys.stdout.write(f"  {time.monotonic() - _BEGAN:5.1f} s  {line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
