"""A channel host that feeds its own channels on command: `python -m tests.benchmarks.fed_host HOST_FLAGS`.

A line on stdin, `PERIOD_SECONDS SECONDS GROUP_ID`, puts an item into every channel in each period, for `SECONDS`. The
answer is a line of JSON, a `FedRates`. GROUP_ID, in hexadecimal digits or `-`, names the group whose cut is observed.
The items go directly into the cores, because clients that put 6400 items a second would use up the machine. The rest of
the host is as usual.
"""

from __future__ import annotations

import asyncio
import json
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host import app, served_host
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.cluster.registration import START_SECONDS_MAX
from stampede_rt_channel_host.core.channel import Offer
from stampede_rt_channel_host.groups.link import HostLink
from stampede_rt_channel_host.host import ChannelHost

STEPS_PER_PERIOD = 10  # channels put in different steps, so that a host does not join their changes into one message
LAG_STEPS = 50  # the number of steps from one look at the cut to the next
PAYLOAD = b"x" * 64
NO_GROUP = "-"


@dataclass(frozen=True, kw_only=True)
class FedRates:
    """The work of this process during one command: items put, CPU time, messages to other hosts, the lag of the cut.

    `cut_lag_ms` is the median lag. It is None without a group, and if the host had no cut of the group.
    """

    items: int
    cpu_s: float
    wall_s: float
    messages: int
    cut_lag_ms: float | None


class FedHost(ChannelHost):
    """Carries out commands of standard input once it has entered the cluster. Ends as any host does."""

    async def enter(
        self, target: str, timeout_s: float = START_SECONDS_MAX, *, local_target: str = "", tcp_target: str = ""
    ) -> None:
        """See ChannelHost."""
        await super().enter(target, timeout_s, local_target=local_target, tcp_target=tcp_target)
        self._start(_run_commands(self), "commands")


class Messages:
    """Counts the messages of links."""

    sent = 0

    @classmethod
    def count(cls) -> None:
        """Count from now on, in this process."""
        gather = HostLink._gather

        def counted(link: HostLink) -> Any:
            cls.sent += 1
            return gather(link)

        HostLink._gather = counted  # type: ignore[method-assign]


async def _run_commands(host: ChannelHost) -> None:
    commands = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(commands), sys.stdin)
    while command := await commands.readline():
        period_s, seconds, group = command.decode().split()
        group_id = bytes.fromhex(group) if group != NO_GROUP else None
        print(json.dumps(asdict(await _feed(host, float(period_s), float(seconds), group_id))), flush=True)


async def _feed(host: ChannelHost, period_s: float, seconds: float, group_id: bytes | None) -> FedRates:
    hosted = sorted(host.store.all(), key=lambda one: one.record.name)
    step_s = period_s / STEPS_PER_PERIOD
    items, lags_ms = 0, list[float]()
    sent, cpu, began = Messages.sent, time.process_time(), time.monotonic()
    for number in range(round(seconds / step_s)):
        items += _put(host, hosted[number % STEPS_PER_PERIOD :: STEPS_PER_PERIOD])
        if group_id is not None and number % LAG_STEPS == 0:
            lags_ms += _lags_ms(host, group_id)
        await asyncio.sleep(max(0.0, began + (number + 1) * step_s - time.monotonic()))
    return FedRates(
        items=items,
        cpu_s=time.process_time() - cpu,
        wall_s=time.monotonic() - began,
        messages=Messages.sent - sent,
        cut_lag_ms=statistics.median(lags_ms) if lags_ms else None,
    )


def _put(host: ChannelHost, channels: Sequence[HostedChannel]) -> int:
    for hosted in channels:
        now = host.store.now()
        raw = encode_run([PAYLOAD], times=[now])
        offer = Offer(times=[now], durations=None, lengths=[len(PAYLOAD)])
        hosted.channel.put(offer, now, lambda first_seq, kept, stamped, raw=raw: seal_run(raw, first_seq))
        hosted.changed(now)
    return len(channels)


def _lags_ms(host: ChannelHost, group_id: bytes) -> list[float]:
    """The lag of the group's cut now, if the group has a cut at this host."""
    group = host.groups.known(group_id)
    return [] if group is None or group.cut.cut is None else [(host.store.now() - group.cut.cut) / 1e6]


def main() -> int:
    """Run the host; returns its exit code."""
    Messages.count()
    served_host.ChannelHost = FedHost  # type: ignore[misc]
    return app.main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
