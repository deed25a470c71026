"""The work of each process of a run: operate, publish or read."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from array import array
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import NamedTuple

from stampede_rt_bench.workloads.catalogue import Workload
from stampede_rt_bench.workloads.interface import Client, MeasuredSystem, RunningServer, WorkloadNeeds
from stampede_rt_bench.workloads.payloads import at_full_speed, at_rate
from stampede_rt_bench.workloads.receiving import AnswerReceiver, CountingReceiver, OperationTimer, TimingReceiver
from stampede_rt_bench.workloads.run_counters import RunCounters


class Assignment(NamedTuple):
    """The instructions for every process of a run."""

    system: MeasuredSystem
    served: RunningServer
    needs: WorkloadNeeds
    workload: Workload
    progress: RunCounters
    deadline_s: float


class WorkerOutcome(NamedTuple):
    """The report of a process at its end: its measured times in nanoseconds, or why it failed."""

    nanos: array[int]
    failure: str = ""


Role = Callable[[Assignment, int, Client], "array[int]"]


def play(role: Role, assignment: Assignment, number: int, results: Connection) -> None:
    """Do the work of one process: connect, run `role`, and send the outcome to `results`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # after Ctrl-C the first process ends this one
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ.update(assignment.served.environment)
    try:
        client = assignment.system.connect(assignment.served, assignment.needs)
        outcome = WorkerOutcome(role(assignment, number, client))
        results.send(outcome)
        client.close()
    except BaseException:  # noqa: BLE001 - the first process shows it
        results.send(WorkerOutcome(array("Q"), traceback.format_exc()))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def operate(assignment: Assignment, number: int, client: Client) -> array[int]:
    """Do one operation again and again. Before that, put the items that the operation reads."""
    _, _, needs, workload, progress, deadline_s = assignment
    answers = AnswerReceiver(progress, number, needs.item_bytes, deadline_s)
    operations = OperationTimer(progress, answers, 0 if workload.kind == "put" else workload.items)
    payload = bytes(needs.item_bytes)
    if workload.kind != "put":
        client.publish(iter([[payload] * workload.items]))
    progress.set_ready(number)
    if workload.kind == "put":
        client.put(operations.repeat(payload))
    elif workload.kind == "newest":
        client.newest(operations.repeat(1), answers)
    else:
        client.interval(operations.repeat(workload.items), answers)
    return operations.durations_nanos


def publish(assignment: Assignment, number: int, client: Client) -> array[int]:
    """Send items when all readers are ready, until the run ends."""
    _, _, needs, workload, progress, deadline_s = assignment
    while not progress.all_ready() and not progress.has_ended(deadline_s):
        time.sleep(0.01)
    timed_batches = at_rate(progress, needs.item_bytes, workload.rate, deadline_s, workload.items_total)
    client.publish(timed_batches if workload.rate else at_full_speed(progress, needs, deadline_s))
    return array("Q")


def read(assignment: Assignment, number: int, client: Client) -> array[int]:
    """Take items until the run ends."""
    _, _, needs, workload, progress, deadline_s = assignment
    receiver_type = TimingReceiver if workload.rate else CountingReceiver
    receiver = receiver_type(progress, number, needs.item_bytes, deadline_s)
    client.subscribe(receiver)
    return receiver.latencies_nanos if isinstance(receiver, TimingReceiver) else array("Q")
