"""Starts the cluster and the roles of the rover demo, and makes one report from their reports. No frame passes through
this module."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed, one_sentence
from stampede_rt_demos.rover.faults import Faults
from stampede_rt_demos.rover.programme import PLANNER_JOINS, STREAM_MAX_AGE, is_taken
from stampede_rt_demos.rover.report import RoverReport
from stampede_rt_demos.staging.clip import decode_clock
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.messages import Message
from stampede_rt_demos.staging.progress import Progress
from stampede_rt_demos.staging.role_processes import RoleProcesses, role_command
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND, LoopedClock
from stampede_rt_demos.stereo.programme import DEPTH_CHANNEL, Side, sent
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceFailed

HOSTS = 2
READY_SECONDS = 60.0
END_SECONDS = 120.0
"""The longest time from the last frame's due time to the end of all roles. A busy machine puts and matches late."""
LEAD_NANOS = 600_000_000
CONSUMERS = {"depth": "stereo", "planner": "rover"}
"""The consumers, and the demo to which each belongs: the depth consumer is part of the stereo demo, unchanged."""


def conduct(seconds: int, progress: Progress) -> RoverReport:
    """Run the demo for `seconds`. Blocks for about twenty seconds more. If a part fails, raises DemoFailed."""
    clock = decode_clock(locate_film())
    progress.print_line(f"Starting a cluster: 1 front-end, 1 supernode, {HOSTS} channel hosts ...")
    try:
        with LocalCluster(supernodes=1, hosts=HOSTS) as cluster:
            environment = {"STAMPEDE_SECRET_FILE": str(cluster.secret_file)}
            with st.connect(cluster.address, secret=cluster.secret_file) as rt, RoleProcesses(environment) as roles:
                rt.channel(DEPTH_CHANNEL, max_age=STREAM_MAX_AGE, codec="json", replicas=1, ack="replica", host="h1")
                _start_roles(roles, cluster, seconds, progress)
                results, events = _play(roles, cluster, rt, seconds, progress)
    except st.StampedeError as error:  # this clause is first, because some of these errors are also OSErrors
        raise DemoFailed(f"the cluster does not answer as it should: {error}") from error
    except (ServiceFailed, OSError) as error:
        raise DemoFailed(f"the cluster did not start: {one_sentence(str(error))}") from error
    return _report(results, events, clock, seconds)


def _start_roles(roles: RoleProcesses, cluster: LocalCluster, seconds: int, progress: Progress) -> None:
    """Start the rover. When its channels and group exist, start the consumers."""
    progress.print_line("Starting the rover, a host in a process of its own, and 2 consumers ...")
    roles.start("rover", role_command("rover", "rig", cluster.address, seconds))
    _wait_ready(roles, 1)
    for name, demo in CONSUMERS.items():
        roles.start(name, role_command(demo, name, cluster.address, seconds))
    _wait_ready(roles, len(CONSUMERS))


def _wait_ready(roles: RoleProcesses, count: int) -> None:
    for _, message in roles.events(READY_SECONDS, "getting ready"):
        count -= message["event"] == "ready"
        if not count:
            return


def _play(
    roles: RoleProcesses, cluster: LocalCluster, rt: st.Connection, seconds: int, progress: Progress
) -> tuple[Mapping[str, Message], Sequence[tuple[int, str]]]:
    """Start the programme and the faults, and listen until every role has given its result."""
    results: dict[str, Message] = {}
    items: dict[str, int] = {}
    start = time.time_ns() + LEAD_NANOS
    faults = Faults(cluster, rt, start, seconds * NANOS_PER_SECOND)
    roles.begin(start)
    faults.begin()
    for name, message in roles.events(seconds + END_SECONDS, "the programme"):
        if message["event"] == "progress":
            items[name] = message["items"]
            elapsed = min(max((time.time_ns() - start) / NANOS_PER_SECOND, 0.0), seconds)
            last = faults.events[-1][1] if faults.events else "the rover hosts its own channels"
            frames, pairs = items.get("rover", 0), items.get("depth", 0)
            progress.show(f"{elapsed:4.1f} of {seconds} s  frames {frames:>4}  pairs {pairs:>4}  {last}")
        elif message["event"] == "result":
            results[name] = message
    progress.close()
    faults.end()
    return results, faults.events


def _report(
    results: Mapping[str, Message], events: Sequence[tuple[int, str]], clock: LoopedClock, seconds: int
) -> RoverReport:
    left, right = (set(filter(is_taken, sent(side, clock, seconds * NANOS_PER_SECOND))) for side in Side)
    rover, depth, planner = results["rover"], results["depth"], results["planner"]
    return RoverReport(
        seconds=seconds, frames=len(left) + len(right), pairs_possible=len(left & right),
        puts=[(at, nanos) for at, nanos in rover["put"]], by_reference=rover["by_reference"],
        pairs=depth["left"]["pairs"],
        wrong=depth["left"]["wrong"] + depth["right"]["wrong"] + planner["wrong"],
        dropped=depth["left"]["dropped"] + depth["right"]["dropped"] + planner["dropped"],
        measured=[(at, disparity) for at, disparity, _ in depth["measured"]],
        planner_pairs=planner["pairs"],
        commands=(planner["sent"], len(rover["speeds"]), planner["unsent"]),
        events=[(round(PLANNER_JOINS * seconds * NANOS_PER_SECOND), "the planner joins"), *events],
    )  # fmt: skip
