"""One member as a process. Its standard input takes the commands `propose TEXT`, `entries`, `leader`, and `disk`
(whether the member waits for its disk).

Arguments: the member id, the folder for stores and sockets, and the ids of all members. Every answer is one line. Two
answers are not results: UNKNOWN_OUTCOME and REFUSED.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import grpc
import grpc.aio

from stampede_rt_supernode.replication import (
    CHANNEL_OPTIONS,
    LogUnavailable,
    Member,
    OutcomeUnknown,
    ReplicationSettings,
    open_replicated_log,
)
from tests.support.supernode.list_machine import ListMachine

UNKNOWN_OUTCOME = "may-or-may-not-be-done"
REFUSED = "certainly-not-done"


async def serve(member_id: str, folder: Path, ids: list[str]) -> None:
    members = [Member(member_id=each, address=f"unix:{folder / each}.sock") for each in ids]
    [self_member] = [member for member in members if member.member_id == member_id]
    server, machine = grpc.aio.server(), ListMachine()
    server.add_insecure_port(self_member.address)
    settings = ReplicationSettings(
        self_member=self_member, initial_members=members, data_dir=folder / member_id, snapshot_every_entries=50
    )
    log = await open_replicated_log(
        settings, machine, lambda address: grpc.aio.insecure_channel(address, options=CHANNEL_OPTIONS), server
    )
    await server.start()
    while line := await asyncio.to_thread(sys.stdin.readline):
        verb, _, text = line.strip().partition(" ")
        try:
            if verb == "propose":
                answer = (await log.propose(text.encode(), timeout=10.0)).decode()
            elif verb == "leader":
                answer = str(log.status().leader_id)
            elif verb == "disk":
                answer = "silent" if log.status().disk_silent_seconds else "answers"
            else:
                await log.confirm_read(timeout=10.0)
                answer = " ".join(command.decode() for _, command in machine.entries)
        except OutcomeUnknown:
            answer = UNKNOWN_OUTCOME
        except LogUnavailable:
            answer = REFUSED
        print(answer, flush=True)


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1], Path(sys.argv[2]), sys.argv[3:]))
