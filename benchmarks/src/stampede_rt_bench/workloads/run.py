"""Performs one run: starts a new server and the processes of the workload, and measures for a time in steady state."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess

from stampede_rt_bench.workloads.catalogue import Workload
from stampede_rt_bench.workloads.interface import MeasuredSystem
from stampede_rt_bench.workloads.payloads import needs_of
from stampede_rt_bench.workloads.processes import cpu_seconds
from stampede_rt_bench.workloads.roles import Assignment, Role, WorkerOutcome, operate, play, publish, read
from stampede_rt_bench.workloads.run_counters import RunCounters

START_SECONDS, START_SECONDS_READER, DRAIN_SECONDS, END_SECONDS = 30.0, 1.0, 1.0, 30.0
WARM_SHARE, WARM_SECONDS_MIN = 0.2, 0.3
LATE_NANOS = 1_000_000_000
NANOS_PER_US, US_PER_SECOND = 1000, 1_000_000
# The modules that each process finds imported, if they are installed.
PRELOADED = ["stampede_rt", "grpc", "grpc.aio", "stampede_rt_bench.workloads.roles", "redis", "nats", "zenoh"]


class RunFailed(Exception):
    """A process of a run failed, or did not end; the text says which."""


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """The results of one run.

    `p50_us`, `p99_us` and `p999_us` are percentiles of the time of an operation, or of the time from put to reader.
    They are 0 for a workload at full speed. `lost_share`: the share of items that readers did not get.
    `cpu_us_per_item` is the CPU time of all processes, `server_cpu_us_per_item` the CPU time of only the server.
    `server_cores`: the share of a core that each process of the server used.
    """

    seconds: float
    items_per_second: float
    cpu_us_per_item: float
    server_cpu_us_per_item: float = 0
    lost_share: float = 0
    p50_us: float = 0
    p99_us: float = 0
    p999_us: float = 0
    server_cores: tuple[float, ...] = ()


def percentile(ordered: array[int] | list[int], part: float) -> float:
    """Return the value below which `part` of the ordered values are, in microseconds; 0 without values."""
    return ordered[min(len(ordered) - 1, int(part * len(ordered)))] / NANOS_PER_US if len(ordered) else 0.0


def measure(system: MeasuredSystem, workload: Workload, seconds: float) -> RunResult:
    """Run the workload on the system. Raises RunFailed, ServerFailed."""
    with _running(system, workload, seconds) as (team, assignment):
        return _measure(team, assignment, seconds)


def count_lost(system: MeasuredSystem, workload: Workload) -> list[int]:
    """Publish `workload.items_total` items. Returns the lost items of each reader. Raises as `measure` does."""
    seconds = workload.items_total / workload.rate
    with _running(system, workload, seconds) as (team, assignment):
        progress = assignment.progress
        team.wait(progress.all_ready, _start_seconds(workload), "the readers are not ready")
        team.wait(
            lambda: progress.published() >= workload.items_total, seconds + END_SECONDS, "not all items are published"
        )
        team.finish()
        return [workload.items_total - received for received in progress.received_by_reader()]


def _start_seconds(workload: Workload) -> float:
    return START_SECONDS + workload.readers * START_SECONDS_READER


@contextmanager
def _running(system: MeasuredSystem, workload: Workload, seconds: float) -> Iterator[tuple[_Team, Assignment]]:
    """A context in which the server and the processes of the workload run."""
    context = get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    needs = needs_of(workload.item_bytes, 2 * workload.items, readers=workload.readers, keeps=workload.is_operation)
    progress = RunCounters(context, workload.readers)
    with ExitStack() as stack:
        served = stack.enter_context(system.served(needs))
        deadline_s = time.monotonic() + _start_seconds(workload) + START_SECONDS + 2 * seconds + END_SECONDS
        assignment = Assignment(system, served, needs, workload, progress, deadline_s)
        yield stack.enter_context(_Team(context, assignment)), assignment


def _measure(team: _Team, assignment: Assignment, seconds: float) -> RunResult:
    workload, progress = assignment.workload, assignment.progress
    team.wait(progress.all_ready, _start_seconds(workload), "the readers are not ready")
    team.wait(lambda: progress.received_by_each() > 0, START_SECONDS, "nothing arrives")
    time.sleep(max(WARM_SECONDS_MIN, WARM_SHARE * seconds))
    progress.measure(True)
    begun, begun_cpu_s = _reading(team, assignment), _cpu_by_server(assignment)
    time.sleep(seconds)
    ended, ended_cpu_s = _reading(team, assignment), _cpu_by_server(assignment)
    progress.measure(False)
    lasted, served, worked, received = (after - before for before, after in zip(begun, ended, strict=True))
    if not received:
        raise RunFailed(f"{assignment.system.name}, {workload.name}: nothing arrived in {seconds:g} s")
    outcomes = team.finish()
    items = received * workload.items
    rates = RunResult(
        seconds=lasted,
        items_per_second=items / lasted,
        cpu_us_per_item=(served + worked) / items * US_PER_SECOND,
        server_cpu_us_per_item=served / items * US_PER_SECOND,
        server_cores=tuple((after - before) / lasted for before, after in zip(begun_cpu_s, ended_cpu_s, strict=True)),
    )
    return _with_times(rates, workload, [outcome.nanos for outcome in outcomes if outcome.nanos], progress)


def _reading(team: _Team, assignment: Assignment) -> tuple[float, float, float, int]:
    """The time, the CPU seconds of the server and of the clients, and the received items."""
    cpu_s = cpu_seconds(assignment.served.pids), cpu_seconds(team.pids)
    return time.monotonic(), *cpu_s, assignment.progress.received_by_all()


def _cpu_by_server(assignment: Assignment) -> list[float]:
    return [cpu_seconds([pid]) for pid in assignment.served.pids]


def _with_times(
    measured: RunResult, workload: Workload, by_process: list[array[int]], progress: RunCounters
) -> RunResult:
    """Return `measured` with the times and the share of lost items. A frame that takes over a second counts as lost."""
    together = sorted(nanos for one in by_process for nanos in one)
    worst = max((percentile(sorted(one), 0.99) for one in by_process), default=0.0)
    expected = progress.published() * workload.readers
    late = sum(nanos > LATE_NANOS for nanos in together) if workload.kind == "frames" else 0
    lost = 0.0 if workload.is_operation else max(0.0, 1 - (progress.received_by_all() - late) / expected)
    return replace(
        measured,
        lost_share=lost,
        p50_us=percentile(together, 0.5),
        p99_us=worst if workload.kind == "frames" else percentile(together, 0.99),
        p999_us=percentile(together, 0.999),
    )


class _Team:
    """The processes of a run. At the end of the context all of them have ended."""

    def __init__(self, context: ForkServerContext, assignment: Assignment) -> None:
        self._assignment = assignment
        roles: list[tuple[Role, int]] = [(operate, 0)] if assignment.workload.is_operation else [(publish, 0)]
        if not assignment.workload.is_operation:
            roles += [(read, number) for number in range(assignment.workload.readers)]
        self._members = [self._start(context, role, number) for role, number in roles]

    def _start(self, context: ForkServerContext, role: Role, number: int) -> tuple[BaseProcess, Connection]:
        results, outcome = context.Pipe(duplex=False)
        process = context.Process(target=play, args=(role, self._assignment, number, outcome), daemon=True)
        process.start()
        outcome.close()
        return process, results

    @property
    def pids(self) -> list[int]:
        """The process ids of all processes."""
        return [process.pid for process, _ in self._members if process.pid is not None]

    def wait(self, condition: Callable[[], bool], seconds: float, otherwise: str) -> None:
        """Wait until the condition holds. Raises RunFailed after `seconds`, and if a process has failed."""
        until_s = time.monotonic() + seconds
        while not condition():
            for _, results in self._members:
                if results.poll() and not condition():  # if the condition holds, the process may have ended as planned
                    self._accept(results)
            if time.monotonic() > until_s:
                raise RunFailed(f"{self._title}: {otherwise} after {seconds:g} s")
            time.sleep(0.01)

    def finish(self) -> list[WorkerOutcome]:
        """End the publisher first. End the readers when they have all items, or get no item for a second."""
        progress, workload = self._assignment.progress, self._assignment.workload
        progress.stop_publishing()
        publisher = [] if workload.is_operation else [self._accept(self._members[0][1])]
        received, last_received_s = progress.received_by_all(), time.monotonic()
        while received < progress.published() * workload.readers and time.monotonic() - last_received_s < DRAIN_SECONDS:
            time.sleep(0.01)
            if progress.received_by_all() > received:
                received, last_received_s = progress.received_by_all(), time.monotonic()
        progress.end()
        return publisher + [self._accept(results) for _, results in self._members[len(publisher) :]]

    def _accept(self, results: Connection) -> WorkerOutcome:
        if not results.poll(END_SECONDS):
            raise RunFailed(f"{self._title}: a process did not end within {END_SECONDS:g} s")
        try:
            outcome: WorkerOutcome = results.recv()
        except EOFError:
            raise RunFailed(f"{self._title}: a process died") from None
        if outcome.failure:
            raise RunFailed(f"{self._title}: {outcome.failure}")
        return outcome

    @property
    def _title(self) -> str:
        return f"{self._assignment.system.name}, {self._assignment.workload.name}"

    def __enter__(self) -> _Team:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._assignment.progress.end()
        for process, _ in self._members:
            process.join(1.0)
            if process.is_alive():
                process.kill()
                process.join()
