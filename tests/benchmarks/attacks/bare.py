"""Floods on bare grpcio: attacks that no service can stop, because gRPC itself accepts calls and reads messages.

python -m tests.benchmarks.attacks.bare [NAME...] [--seconds 3] [--runs 3]

Each run has three trials. In `host` the flood and the good clients go to a host, as in the table of attacks. In `bare`
both go to a server that only reads and echoes. In `elsewhere` the good clients go to a host, and the flood goes to that
server, so that both share only the machine. The server has the options of a host's server. All good clients use gRPC,
and the attacker takes only idle processor time.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import sys
from dataclasses import replace
from typing import Any

import grpc

from stampede_rt_bench.tables import Table
from stampede_rt_runtime import open_files
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.main import run_loop
from tests.benchmarks.attacks.own_process import in_own_process
from tests.benchmarks.attacks.trial import AttackResult, Setup, run_trial
from tests.support.processes import started

FLOODS = ("unknown-fields", "repeated-fields", "resets", "health-watches", "many-streams", "single-calls")
RUN_SECONDS_MAX = 180.0
TRANSPORT = "grpc"  # the transport of the good clients in all three trials
SERVE = "serve"


class EchoServer(grpc.GenericRpcHandler):  # type: ignore[misc, unused-ignore]
    """Does as little as a host must do with the calls of the floods. Echoes the messages of the good clients."""

    def service(self, details: Any) -> Any:
        """See grpc."""
        method = details.method.rpartition("/")[2]

        async def serve(_: Any, context: Any) -> None:
            while (message := await context.read()) is not grpc.aio.EOF:
                if method == "EchoServer":
                    await context.write(message)
                elif method == "Get":
                    await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "too long")
            if method == "Watch":
                await context.write(b"")
                await asyncio.Event().wait()
            elif method in ("Check", "GetChannelStatus"):
                await context.write(b"")

        return grpc.stream_stream_rpc_method_handler(serve)


async def serve() -> None:
    """Serve on a free port, which is printed, until standard input ends."""
    open_files.raise_limit()
    server = grpc.aio.server(options=Limits().server_options())
    server.add_generic_rpc_handlers((EchoServer(),))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    print(port, flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    await server.stop(None)


def measure(name: str, seconds: float, kind: str) -> AttackResult:
    """Run one trial in a process of its own."""
    limit_s = RUN_SECONDS_MAX + 4 * seconds
    apart = Setup(apart=True, transport=TRANSPORT)
    if kind == "host":
        return in_own_process(run_trial, name, seconds, apart, seconds=limit_s)
    with started([sys.executable, "-m", "tests.benchmarks.attacks.bare", SERVE]) as process:
        assert process.stdout is not None
        bare = f"127.0.0.1:{process.stdout.readline().strip()}"
        setup = replace(apart, bare=bare, good_go_there=kind == "bare")
        return in_own_process(run_trial, name, seconds, setup, seconds=limit_s)


def row(name: str, kind: str, runs: list[AttackResult]) -> list[str]:
    """The medians of the runs."""

    def median(values: list[float]) -> str:
        return f"{statistics.median(values):.1f}"

    return [
        name,
        kind,
        median([one.alone.quantile_ms(99) for one in runs]),
        median([one.beside.quantile_ms(99) for one in runs]),
        median([one.p99_ratio for one in runs]),
        " ".join(f"{one.p99_ratio:.1f}" for one in runs),
    ]


def main() -> None:
    """Measure the three trials of each flood, one after the other, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.attacks.bare", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(FLOODS)}; none: all")
    parser.add_argument("--seconds", type=float, default=3.0, help="the time of each attack (default: 3)")
    parser.add_argument("--runs", type=int, default=3, help="runs of each trial (default: 3)")
    options = parser.parse_args()
    if options.names == [SERVE]:
        run_loop(serve())
        return
    if unknown := set(options.names) - set(FLOODS):
        parser.error(f"there is no flood {', '.join(sorted(unknown))}; the floods are {', '.join(FLOODS)}")
    table = Table(("flood", "goes to", "p99 alone, ms", "beside it", "times", "of each run"))
    for name in options.names or FLOODS:
        found: dict[str, list[AttackResult]] = {"host": [], "bare": [], "elsewhere": []}
        for _ in range(options.runs):
            for kind, runs in found.items():
                runs.append(measure(name, options.seconds, kind))
                print("  ".join(row(name, kind, runs[-1:])), file=sys.stderr, flush=True)
        table.rows += [row(name, kind, runs) for kind, runs in found.items()]
    print(table.render())


if __name__ == "__main__":
    main()
