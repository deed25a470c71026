"""Starts the cluster and the roles, and makes one report from their reports. Only this module knows all other parts.

No data pass through it. The roles exchange data through channels, and only send reports to the orchestrator.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import stampede_rt as st
from stampede_rt_demos.failures import DemoFailed, one_sentence
from stampede_rt_demos.staging import messages
from stampede_rt_demos.staging.film import locate_film
from stampede_rt_demos.staging.progress import Progress
from stampede_rt_demos.staging.rights import Right, hand_out, operator_credentials
from stampede_rt_demos.staging.role_processes import RoleProcesses, role_command
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND
from stampede_rt_demos.tv_watcher import steps
from stampede_rt_demos.tv_watcher.picture_data import PictureSpan, picture_spans
from stampede_rt_demos.tv_watcher.programme import (
    AUDIO,
    CAPTION_NANOS,
    CAPTIONS,
    GROUP,
    LOUDNESS,
    MOTION,
    SOURCE_OF_FEATURE,
    STREAM_MAX_AGE,
    STREAMS,
    VIDEO,
)
from stampede_rt_demos.tv_watcher.report import RunReport
from stampede_rt_demos.tv_watcher.statistics import StepFigures, stream_figures
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceFailed

FRONTENDS, SUPERNODES, HOSTS = 1, 3, 2
READY_SECONDS = 30.0
END_SECONDS = 15.0
LEAD_NANOS = 400_000_000

PRODUCERS = {
    "video producer": ("video_producer", VIDEO.name),
    "audio producer": ("audio_producer", AUDIO.name),
    "caption producer": ("caption_producer", CAPTIONS.name),
}
READERS = {"motion analyser": "motion_analyser", "loudness analyser": "loudness_analyser", "viewer": "viewer"}
_PUT = ("put", "advance")
RIGHTS = {
    "video producer": (Right(_PUT, "channel", VIDEO.channel),),
    "audio producer": (Right(_PUT, "channel", AUDIO.channel),),
    "caption producer": (Right(_PUT, "channel", CAPTIONS.channel),),
    "motion analyser": (Right(("read",), "channel", VIDEO.channel), Right(_PUT, "channel", MOTION.channel)),
    "loudness analyser": (Right(("read",), "channel", AUDIO.channel), Right(_PUT, "channel", LOUDNESS.channel)),
    "viewer": (*(Right(("read",), "channel", one.channel) for one in STREAMS), Right(("read",), "group", GROUP)),
}
MODULES = {name: module for name, (module, _) in PRODUCERS.items()} | READERS


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """The report of a run, and the data for the picture."""

    report: RunReport
    spans: Sequence[PictureSpan]


@dataclass(slots=True)
class _CollectedReports:
    """The reports so far: results by role, the viewer's steps, the last item counts."""

    results: dict[str, messages.Message] = field(default_factory=dict)
    steps: list[StepFigures] = field(default_factory=list)  # one for each caption; the length of the run bounds them
    items: dict[str, int] = field(default_factory=dict)
    picture: messages.Message = field(default_factory=lambda: {"spans": []})

    def add(self, role: str, message: messages.Message) -> None:
        """Take one event in."""
        match message["event"]:
            case "progress":
                self.items[role] = message["items"]
            case "step":
                self.steps.append(steps.step_of(message))
            case "picture":
                self.picture = message
            case "result":
                self.results[role] = message


def conduct(seconds: int, progress: Progress, *, certificates: bool = False) -> Outcome:
    """Run the whole programme for `seconds`. Blocks for about eight seconds more than that.

    With `certificates` all parts of the cluster and all roles have certificates. Otherwise the roles have tokens.

    If a needed part is missing, does not start, or dies, ends every process and raises DemoFailed.
    """
    locate_film()
    cpu_before = _children_cpu_seconds()
    progress.print_line(
        f"Starting a cluster: {FRONTENDS} front-end, {SUPERNODES} supernodes, {HOSTS} channel hosts ..."
    )
    try:
        with LocalCluster(frontends=FRONTENDS, supernodes=SUPERNODES, hosts=HOSTS, tls=certificates) as cluster:
            collected, accepted, placed = _run_programme(cluster, seconds, progress)
    except st.StampedeError as error:  # this clause is first, because some of these errors are also OSErrors
        raise DemoFailed(f"the cluster does not answer as it should: {error}") from error
    except (ServiceFailed, OSError) as error:
        raise DemoFailed(f"the cluster did not start: {one_sentence(str(error))}") from error
    cpu_seconds = _children_cpu_seconds() - cpu_before
    report = _report(collected, accepted, placed, seconds, cpu_seconds)
    return Outcome(report=report, spans=picture_spans(collected.picture))


def _run_programme(
    cluster: LocalCluster, seconds: int, progress: Progress
) -> tuple[_CollectedReports, Mapping[str, int], Mapping[str, str]]:
    """Run the roles in the running cluster. Returns their reports, the accepted items and the host of each stream."""
    operator = operator_credentials(cluster)
    with st.connect(cluster.address, name="orchestrator", **operator) as rt:
        channels = _create_channels(rt)
        environments = hand_out(cluster, RIGHTS, operator)
        with RoleProcesses() as roles:
            for name, module in MODULES.items():
                roles.start(name, role_command("tv_watcher", module, cluster.address, seconds), environments[name])
            progress.print_line(f"Starting {len(MODULES)} processes: {', '.join(MODULES)} ...")
            _wait_ready(roles)
            collected = _play(roles, seconds, progress)
        accepted = {name: channel.stats().accepted for name, channel in channels.items()}
        return collected, accepted, {name: channel.host for name, channel in channels.items()}


def _create_channels(rt: st.Connection) -> Mapping[str, st.Channel]:
    """Make all channels, some at each host, and the group with the captions as reference."""
    hosts = sorted(host.name for host in rt.hosts())
    channels = {
        stream.name: rt.channel(
            stream.channel,
            max_age=STREAM_MAX_AGE,
            content_type=stream.content_type,
            host=hosts[stream.host_index % len(hosts)],
        )
        for stream in STREAMS
    }
    rt.group(GROUP, list(channels.values()), reference=channels[CAPTIONS.name])
    return channels


def _wait_ready(roles: RoleProcesses) -> None:
    waiting = set(MODULES)
    for name, message in roles.events(READY_SECONDS, "getting ready"):
        if message["event"] == "ready":
            waiting.discard(name)
        if not waiting:
            return


def _play(roles: RoleProcesses, seconds: int, progress: Progress) -> _CollectedReports:
    """Start the programme and listen until every role has given its result."""
    collected = _CollectedReports()
    start = time.time_ns() + LEAD_NANOS
    roles.begin(start)
    for name, message in roles.events(seconds + END_SECONDS, "the programme"):
        collected.add(name, message)
        if message["event"] in ("progress", "step"):
            progress.show(_progress_line(collected, time.time_ns() - start, seconds))
    progress.close()
    return collected


def _progress_line(collected: _CollectedReports, elapsed_nanos: int, seconds: int) -> str:
    elapsed = min(max(elapsed_nanos / NANOS_PER_SECOND, 0.0), seconds)
    items = "  ".join(f"{stream} {collected.items.get(role, 0):>3}" for role, (_, stream) in PRODUCERS.items())
    last = collected.steps[-1].text if collected.steps else ""
    return f"{elapsed:4.1f} of {seconds} s  {items}  in step {len(collected.steps):>2}  {last}"


def _report(
    collected: _CollectedReports,
    accepted: Mapping[str, int],
    placed: Mapping[str, str],
    seconds: int,
    cpu_seconds: float,
) -> RunReport:
    results = collected.results
    receipts = {name: record for role in READERS for name, record in results[role]["receipts"].items()}
    roles_cpu_seconds = sum(float(result["cpu_seconds_in_all"]) for result in results.values())
    return RunReport(
        figures=[
            stream_figures(
                stream.name,
                host=placed[stream.name],
                accepted=accepted[stream.name],
                receipts=receipts[stream.name],
                steps=collected.steps,
                seconds=seconds,
            )
            for stream in STREAMS
        ],
        steps=collected.steps,
        reference=CAPTIONS.name,
        expected=_expected(results),
        lateness_max_nanos={role: results[role]["lateness_max_nanos"] for role in PRODUCERS},
        role_cpu_percent={role: 100 * results[role]["cpu_seconds"] / seconds for role in MODULES},
        cluster_cpu_percent=100 * (cpu_seconds - roles_cpu_seconds) / seconds,
    )


def _expected(results: Mapping[str, messages.Message]) -> dict[str, int]:
    """Compute how many items of each stream begin in a caption's span, from the periods in the producers' reports."""
    sources = {stream: CAPTION_NANOS // results[role]["period_nanos"] for role, (_, stream) in PRODUCERS.items()}
    return {stream.name: sources[SOURCE_OF_FEATURE.get(stream.name, stream.name)] for stream in STREAMS}


def _children_cpu_seconds() -> float:
    """Return the user and system time of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
