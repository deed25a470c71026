"""One attack on a cluster of processes of its own, and the losses of good clients during the attack."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import resource
import secrets
import statistics
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.v1 import access_service_pb2 as access_pb
from stampede_rt.v1.access_service_pb2_grpc import AccessServiceStub
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceProcess
from stampede_rt_runtime.values import Address, parse_address
from tests.benchmarks.attacks.attacked_cluster import GOOD_CHANNEL, OPTIONS, TRANSPORT, AttackedCluster
from tests.benchmarks.attacks.attacker import UNDER_WAY
from tests.benchmarks.attacks.catalogue import CASES
from tests.benchmarks.attacks.competitor import SLOT_SECONDS

MEMORY_BUDGET = "64MiB"
FILES_SOFT = 1024
ROUNDS_PER_CHANNEL = 20
GOOD_CLIENTS, PERIOD_SECONDS, CALL_SECONDS = 2, 0.01, 10.0
ECHOED = b"x" * 150
PUTS_ALONE_MIN = 20
LEASE_LOST = "the lease has ended"
UNDER_WAY_SECONDS = 60.0
TOKEN_NANOS = 3600 * 10**9


@dataclass
class GoodCalls:
    """The calls of good clients: the time of each put, the number of failed calls, and the reasons."""

    puts_ms: list[float] = field(default_factory=list)
    calls: int = 0
    failures: list[str] = field(default_factory=list)

    def quantile_ms(self, percent: int) -> float:
        """The time of a put at this percentile; infinite if no put ended."""
        if len(self.puts_ms) < 2:
            return max(self.puts_ms, default=math.inf)
        return statistics.quantiles(self.puts_ms, n=100, method="inclusive")[percent - 1]

    def note(self, put_ms: float) -> None:
        """Count the time of a put that did not succeed, if it took longer than all other puts."""
        if put_ms > max(self.puts_ms, default=0.0):
            self.puts_ms.append(put_ms)


@dataclass
class AttackResult:
    """The effects of one attack. Memory is the resident set of the watched process, in MiB.

    `competing`: the good clients during a program that takes as much processor time as the attacker took, and makes no
    calls.
    """

    name: str
    alone: GoodCalls = field(default_factory=GoodCalls)
    beside: GoodCalls = field(default_factory=GoodCalls)
    competing: GoodCalls = field(default_factory=GoodCalls)
    attacker_slots: list[float] = field(default_factory=list)
    before_mib: float = 0.0
    most_mib: float = 0.0
    after_mib: float = 0.0
    leases_lost: int = 0
    log_bytes: int = 0

    @property
    def p99_ratio(self) -> float:
        """The time of a put during the attack divided by the time without it, at the 99th percentile."""
        return self.slowdown(self.beside)

    def slowdown(self, beside: GoodCalls) -> float:
        """The time of a put during the attack, as a multiple of the time alone, at the 99th percentile."""
        return beside.quantile_ms(99) / max(0.1, self.alone.quantile_ms(99))

    @property
    def attacker_percent(self) -> float:
        """The processor time of the attacker, in percent of one processor."""
        return 100 * statistics.fmean(self.attacker_slots or [0.0]) / SLOT_SECONDS


@dataclass(frozen=True, kw_only=True)
class Setup:
    """The callers and their servers. `transport`: the transport of the good clients.

    `bare`: the address of a bare server that the attack floods instead of the host. With `good_go_there` the good
    clients call it, too; see `bare.py`. `apart`: the attacker gets only idle processor time, as if it ran on another
    machine. Otherwise the good clients are measured also during a program that takes as much processor time as the
    attacker took. Without `compares` they are measured only during the attack. That is enough for a test of rules that
    do not depend on the time of a put.
    """

    transport: str = TRANSPORT
    bare: str = ""
    good_go_there: bool = False
    apart: bool = False
    compares: bool = True


class TrialCluster:
    """A cluster with one host and one supernode, whose host has a small budget of memory and few open files."""

    def __init__(self, name: str, setup: Setup) -> None:
        self.found = AttackResult(name)
        self.setup = setup
        self.case = CASES[name]
        self.cluster = LocalCluster(hosts=1, supernodes=1, tls=self.case.secured, on_line=self._read_log_line)
        assert self.cluster.folder is not None, "a cluster that keeps its state has a folder"
        archive = ["--archive", str(self.cluster.folder / "archive"), "--archive-bytes-max", MEMORY_BUDGET]
        self._data_port = free_ports(1)[0]
        arguments = ["--data-port", str(self._data_port), "--memory-bytes-max", MEMORY_BUDGET, *archive]
        self.cluster.hosts[0].arguments += arguments

    def _read_log_line(self, process: ServiceProcess, line: str) -> None:
        if not process.is_ready:
            return
        self.found.log_bytes += len(line) + 1
        self.found.leases_lost += LEASE_LOST in line

    @property
    def attacked(self) -> AttackedCluster:
        """The addresses and the credential that the attacker gets."""
        host = self.cluster.hosts[0].address
        return AttackedCluster(
            frontend=self.cluster.address,
            supernode=self.cluster.supernodes[0].address,
            host=host,
            data_port=str(Address(parse_address(host).host, self._data_port)),
            secret=self.token("attacker"),
            flooded=self.setup.bare,
            member_secret=self.cluster.secret.text,
        )

    def token(self, name: str) -> str:
        """A token that proves a name: quotas distinguish callers by name. Empty in a cluster with certificates."""
        if self.case.secured:
            return ""
        bearer = (("authorization", f"Bearer {self.cluster.secret.text}"),)
        request = access_pb.CreateClientTokenRequest(
            request_id=secrets.token_bytes(16), name=name, roles=["client"], valid_nanos=TOKEN_NANOS
        )
        with grpc.insecure_channel(self.cluster.supernodes[0].address) as channel:
            create: Any = AccessServiceStub(channel).CreateClientToken
            return str(create(request, metadata=bearer, timeout=CALL_SECONDS).token)

    async def good(self) -> Any:
        """Open the connection of a good client."""
        transport, address = self.case.transport or self.setup.transport, self.cluster.address
        if (files := self.cluster.tls_files("good")) is not None:
            return st.aio.connect(address, tls=files, transport=transport)
        token = await asyncio.to_thread(self.token, "good")
        return st.aio.connect(address, secret=token, transport=transport)

    def memory_mib(self) -> float:
        """The resident memory of the watched process now, in MiB."""
        parts = self.cluster.hosts if CASES[self.found.name].watched == "host" else self.cluster.supernodes
        pages = int(Path(f"/proc/{parts[0].pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20


@asynccontextmanager
async def trial_cluster(name: str, setup: Setup) -> AsyncIterator[TrialCluster]:
    """Yield the cluster once it is ready."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (FILES_SOFT, hard))  # the cluster's processes inherit this limit
    try:
        one = TrialCluster(name, setup)
        await asyncio.to_thread(one.cluster.__enter__)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    try:
        yield one
    finally:
        await asyncio.to_thread(one.cluster.__exit__, None, None, None)


def run_trial(name: str, seconds: float, setup: Setup) -> AttackResult:
    """A trial in a loop of its own."""
    return asyncio.run(trial(name, seconds, setup))


async def trial(name: str, seconds: float, setup: Setup) -> AttackResult:
    """Measure the good clients alone, then during the attack, and then the memory that stays afterwards.

    Then measure the good clients alone again. So other load of the machine affects the figures with the attack and the
    figures without it. See `Setup.compares`.
    """
    async with trial_cluster(name, setup) as one:
        found = one.found
        async with await one.good() as rt:
            await rt.channel(GOOD_CHANNEL, max_age="10s")
            # before `before_mib`, so that it includes the memory that a serving host needs
            await _good_clients(one, found.alone, asyncio.sleep(seconds / 2))
            found.before_mib, found.log_bytes = one.memory_mib(), 0
            await _good_clients(one, found.beside, _attacked(one, seconds))
            await _memory_settled(one)
            found.after_mib = one.memory_mib()
            if not setup.compares:
                return found
            if not setup.apart and found.attacker_slots:
                await _good_clients(one, found.competing, _competing(one, seconds))
            await _good_clients(one, found.alone, asyncio.sleep(seconds / 2))
    if len(found.alone.puts_ms) < PUTS_ALONE_MIN:
        raise ValueError(f"good clients alone made {len(found.alone.puts_ms)} puts; measure for longer (--seconds)")
    return found


async def _attacked(one: TrialCluster, seconds: float) -> None:
    line = (await asyncio.to_thread(lambda: one.attacked)).to_line()
    words = ("tests.benchmarks.attacks.attacker", one.found.name, *(["apart"] if one.setup.apart else []))
    async with _program(words, line, one.found.beside) as process:
        watching = asyncio.create_task(_watch(one, process.pid))
        try:
            await asyncio.sleep(seconds)
            assert process.returncode is None, f"the attacker of {one.found.name} ended by itself"
        finally:
            watching.cancel()


async def _competing(one: TrialCluster, seconds: float) -> None:
    words, line = ("tests.benchmarks.attacks.competitor",), json.dumps(one.found.attacker_slots)
    async with _program(words, line, one.found.competing):
        await asyncio.sleep(seconds)


@asynccontextmanager
async def _program(words: tuple[str, ...], line: str, good: GoodCalls) -> AsyncIterator[asyncio.subprocess.Process]:
    """Yield a program once it is under way. `good` then has only the calls from this moment on."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", *words), stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(line.encode() + b"\n")
        async with asyncio.timeout(UNDER_WAY_SECONDS):
            first_line = await process.stdout.readline()
        assert first_line.decode().strip() == UNDER_WAY, f"{' '.join(words)} failed"
        good.calls = len(good.failures)  # calls before the attack was under way do not count
        good.puts_ms.clear()
        yield process
    finally:
        process.stdin.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(5.0):
                await process.wait()
        if process.returncode is None:
            process.kill()
            await process.wait()


async def _watch(one: TrialCluster, attacker: int) -> None:
    """Note the memory of the watched process, and the processor time of the attacker."""
    clock = ~attacker << 3 | 2  # the CPU time of all threads of the process, see clock_getcpuclockid(3)
    used_s = time.clock_gettime(clock)
    while True:
        one.found.most_mib = max(one.found.most_mib, one.memory_mib())
        await asyncio.sleep(SLOT_SECONDS)
        before_s, used_s = used_s, time.clock_gettime(clock)
        one.found.attacker_slots.append(used_s - before_s)


async def _memory_settled(one: TrialCluster) -> None:
    """Wait until the memory of the process has changed by less than a MiB for 3 s, 15 s at most.

    Services give memory back each second.
    """
    last, since_s, until_s = one.memory_mib(), time.monotonic(), time.monotonic() + 15.0
    while time.monotonic() < min(since_s + 3.0, until_s):
        await asyncio.sleep(SLOT_SECONDS)
        if abs(one.memory_mib() - last) > 1.0:
            last, since_s = one.memory_mib(), time.monotonic()


async def _good_clients(one: TrialCluster, good: GoodCalls, meanwhile: Any) -> None:
    """Run the good clients until `meanwhile` has ended. Each client puts and reads on its own connection."""
    tasks = [asyncio.create_task(_good_client(one, good)) for _ in range(GOOD_CLIENTS)]
    try:
        await meanwhile
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)


async def _good_client(one: TrialCluster, good: GoodCalls) -> None:
    if one.setup.good_go_there:
        await _bare_client(one.setup.bare, good)
        return
    async with await one.good() as rt:
        channel = await rt.channel(GOOD_CHANNEL)
        await _put_and_read(channel, GoodCalls())  # not counted, because this put opens the connection to the host
        asks = CASES[one.found.name].watched == "supernode"
        for number in itertools.count(1):
            await _put_and_read(channel, good)
            if asks and number % ROUNDS_PER_CHANNEL == 0:
                await _make_and_delete(rt, good)
            await asyncio.sleep(PERIOD_SECONDS)


async def _bare_client(target: str, good: GoodCalls) -> None:
    """The messages of a put and of a read, on a stream of a bare server."""
    async with grpc.aio.insecure_channel(target, options=OPTIONS) as connection:
        call: Any = connection.stream_stream("/bare/Echo")()
        while True:
            for times_ms in (good.puts_ms, []):
                began_s = time.perf_counter()
                await call.write(ECHOED)
                await call.read()
                times_ms.append((time.perf_counter() - began_s) * 1000)
                good.calls += 1
            await asyncio.sleep(PERIOD_SECONDS)


async def _make_and_delete(rt: Any, good: GoodCalls) -> None:
    """Make a channel and delete it, as a call to the supernode."""
    good.calls += 2
    try:
        await (await rt.channel(f"{GOOD_CHANNEL}/{secrets.token_hex(8)}")).delete()
    except st.StampedeError as error:
        good.failures.append(str(error))


async def _put_and_read(channel: Any, good: GoodCalls) -> None:
    began_s, is_put = time.perf_counter(), False
    good.calls += 2
    try:
        await channel.put(b"x" * 100, timeout=CALL_SECONDS)
        good.puts_ms.append((time.perf_counter() - began_s) * 1000)
        is_put = True
        await channel.newest(timeout=CALL_SECONDS)
    except st.StampedeError as error:
        good.failures.append(str(error))
    finally:
        if not is_put:  # the put failed, or the trial ended during the put
            good.note((time.perf_counter() - began_s) * 1000)
