"""Starts the cluster and the roles of the stereo demo, and makes one report from their reports. No frame passes through
this module."""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed, one_sentence
from stampede_rt_demos.staging.clip import decode_clock
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.messages import Message
from stampede_rt_demos.staging.progress import Progress
from stampede_rt_demos.staging.rights import Right, hand_out, operator_credentials
from stampede_rt_demos.staging.role_processes import RoleProcesses, role_command
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND, LoopedClock
from stampede_rt_demos.stereo.programme import (
    DEPTH_CHANNEL,
    GROUP,
    MAPPER,
    PLANNER,
    STREAM_MAX_AGE,
    Side,
    sent,
    without_partner,
)
from stampede_rt_demos.stereo.report import StereoReport
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceFailed

SUPERNODES, HOSTS = 3, 2
READY_SECONDS = 30.0
END_SECONDS = 120.0
"""The longest time from the last frame's due time to the end of all roles. A busy machine puts and matches late."""
LEAD_NANOS = 600_000_000
ROLES = {
    "left camera": "left_camera",
    "right camera": "right_camera",
    "depth": "depth",
    "latecomer": "latecomer",
    "planner": "planner",
    "mapper": "mapper",
}
_PAIRS = (*(Right(("read",), "channel", side.value) for side in Side), Right(("read",), "group", GROUP))
RIGHTS = {
    "left camera": (Right(("put", "advance"), "channel", Side.LEFT.value),),
    "right camera": (Right(("put", "advance"), "channel", Side.RIGHT.value),),
    "depth": (*_PAIRS, Right(("put", "advance"), "channel", DEPTH_CHANNEL)),
    "latecomer": _PAIRS,
    "planner": (Right(("read",), "channel", DEPTH_CHANNEL), Right(("send",), "peer", MAPPER)),
    "mapper": (Right(("read",), "channel", DEPTH_CHANNEL), Right(("send",), "peer", PLANNER)),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """A run's report, and the last pair as JPEG, left and right."""

    report: StereoReport
    frames: Sequence[bytes]


def conduct(seconds: int, progress: Progress, *, certificates: bool = False) -> Outcome:
    """Run the demo for `seconds`. Blocks for about ten seconds more than that.

    With `certificates` all parts of the cluster and all roles have certificates. Otherwise the roles have tokens.

    If a needed part is missing, does not start, or dies, ends every process and raises DemoFailed.
    """
    clock = decode_clock(locate_film())
    progress.print_line(f"Starting a cluster: 1 front-end, {SUPERNODES} supernodes, {HOSTS} channel hosts ...")
    try:
        with LocalCluster(supernodes=SUPERNODES, hosts=HOSTS, tls=certificates) as cluster:
            results, frames = _run(cluster, seconds, progress)
    except st.StampedeError as error:  # this clause is first, because some of these errors are also OSErrors
        raise DemoFailed(f"the cluster does not answer as it should: {error}") from error
    except (ServiceFailed, OSError) as error:
        raise DemoFailed(f"the cluster did not start: {one_sentence(str(error))}") from error
    return Outcome(report=_report(results, clock, seconds), frames=frames)


def _run(cluster: LocalCluster, seconds: int, progress: Progress) -> tuple[Mapping[str, Message], Sequence[bytes]]:
    operator = operator_credentials(cluster)
    with st.connect(cluster.address, **operator) as rt:
        _set_up(rt)
        environments = hand_out(cluster, RIGHTS, operator)
        with RoleProcesses() as roles:
            for name, module in ROLES.items():
                roles.start(name, role_command("stereo", module, cluster.address, seconds), environments[name])
            progress.print_line(f"Starting {len(ROLES)} processes: {', '.join(ROLES)} ...")
            _wait_ready(roles)
            return _play(roles, seconds, progress)


def _set_up(rt: st.Connection) -> None:
    """Make the channel of each camera at its own host, and the group of both."""
    hosts = sorted(host.name for host in rt.hosts())
    cameras = [
        rt.channel(side.value, max_age=STREAM_MAX_AGE, content_type="image/jpeg", host=host)
        for side, host in zip(Side, hosts, strict=True)
    ]
    rt.channel(DEPTH_CHANNEL, max_age=STREAM_MAX_AGE, codec="json")
    rt.group(GROUP, cameras, reference="oldest")


def _wait_ready(roles: RoleProcesses) -> None:
    waiting = set(ROLES)
    for name, message in roles.events(READY_SECONDS, "getting ready"):
        if message["event"] == "ready":
            waiting.discard(name)
        if not waiting:
            return


def _play(roles: RoleProcesses, seconds: int, progress: Progress) -> tuple[Mapping[str, Message], Sequence[bytes]]:
    """Start the programme and listen until every role has given its result."""
    results: dict[str, Message] = {}
    items: dict[str, int] = {}
    frames: list[bytes] = []
    start = time.time_ns() + LEAD_NANOS
    roles.begin(start)
    for name, message in roles.events(seconds + END_SECONDS, "the programme"):
        match message["event"]:
            case "progress":
                items[name] = message["items"]
                elapsed = min(max((time.time_ns() - start) / NANOS_PER_SECOND, 0.0), seconds)
                progress.show(
                    f"{elapsed:4.1f} of {seconds} s  left {items.get('left camera', 0):>3}  right "
                    f"{items.get('right camera', 0):>3}  pairs {items.get('depth', 0):>3}  answers "
                    f"{items.get('planner', 0):>3}"
                )
            case "picture":
                frames = [base64.b64decode(frame) for frame in message["frames"]]
            case "result":
                results[name] = message
    progress.close()
    return results, frames


def _report(results: Mapping[str, Message], clock: LoopedClock, seconds: int) -> StereoReport:
    length = seconds * NANOS_PER_SECOND
    left, right = (set(sent(side, clock, length)) for side in Side)
    depth = results["depth"]
    return StereoReport(
        seconds=seconds,
        sent={side: len(numbers) for side, numbers in zip(Side, (left, right), strict=True)},
        pairs_possible=len(left & right),
        pairs=depth["left"]["pairs"],
        wrong=depth["left"]["wrong"] + depth["right"]["wrong"] + results["latecomer"]["wrong"],
        alone_expected={side: without_partner(side, clock, length) for side in Side},
        alone_reported={Side.LEFT: depth["left"]["alone"], Side.RIGHT: depth["right"]["alone"]},
        dropped=depth["left"]["dropped"] + depth["right"]["dropped"],
        measured=[(at, disparity, truth) for at, disparity, truth in depth["measured"]],
        latecomer_pairs=results["latecomer"]["pairs"],
        put_p50_nanos={
            side: (results[name]["put_p50_before_nanos"], results[name]["put_p50_after_nanos"])
            for side, name in zip(Side, ("left camera", "right camera"), strict=True)
        },
        answers=results["planner"]["answers"],
        unanswered=results["planner"]["unanswered"],
        stops=results["planner"]["stops"],
        round_trip_p50_nanos=results["planner"]["round_trip_p50_nanos"],
    )
