"""Puts that wait for the disk while it fails."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from stampede_rt.v1 import channel_pb2, error_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.policy import parse_policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.segment_files import SegmentFiles
from stampede_rt_channel_host.archive_setup import set_up_archive
from tests.support.channel_host.rig import HOST_ID, OpenedChannel, run_of, running_host

PRODUCER = 7


async def put(channel: OpenedChannel, number: int) -> pb.PutAck:
    run = run_of(b"x", number=number, ack=channel_pb2.ACK_DISK)
    (ack,) = await channel.put(run, producer_id=PRODUCER)
    assert ack.error.reason == error_pb2.ERROR_REASON_NOT_ARCHIVED
    return ack


async def test_the_error_of_a_put_repeated_while_the_disk_fails_says_that_the_channel_has_its_items(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    folder = ArchiveFolder(tmp_path / "archive")
    folder.open(HOST_ID)
    monkeypatch.setattr(SegmentFiles, "write", refuse)
    async with running_host() as rig:
        set_up_archive(rig.host.store.recordings, folder, None, rig.accounts, rig.now)
        channel = await rig.open(spec=policy_to_spec(parse_policy(max_items=10, archive="1h")))
        first = await put(channel, number=1)
        repeated, other = await put(channel, number=1), await put(channel, number=2)
        assert (first.first_seq, repeated.first_seq, other.HasField("first_seq")) == (1, 1, False)
        assert (repeated.error.metadata["seq"], "seq" in other.error.metadata) == ("1", False)
        assert (await channel.get()).payloads == [b"x"]
