from typing import Any

import pytest

from stampede_rt.errors import VersionMismatch
from stampede_rt.model import Policy
from stampede_rt.v1 import directory_command_pb2
from stampede_rt_supernode.command_codec import decode_command, decode_result, encode_command, encode_result
from stampede_rt_supernode.commands import (
    ChannelDeleted,
    ChannelOpened,
    ChannelUpdated,
    Command,
    Deed,
    HostDeregistered,
    HostExpired,
    HostRegistered,
    Refused,
    Result,
    TenureBegun,
)
from stampede_rt_supernode.records import Channel, Endpoint, Host
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication import COMMAND_BYTES_MAX
from stampede_rt_supernode.snapshot_codec import decode_snapshot
from tests.unit.supernode.deeds import begin_tenure, delete, deregister, expire, id_of, open_channel, register, update

EVERYTHING: dict[str, Any] = {
    "max_age_nanos": 1,
    "max_items": 2,
    "max_bytes": 3,
    "consumers": 4,
    "on_full": "block",
    "max_future_nanos": 0,
    "content_type": "",
    "max_item_bytes": 5,
}
DEEDS: list[Deed] = [
    open_channel("cam", host="rig", create=False, **EVERYTHING),
    open_channel("cam"),
    update(id_of(1), 2**64 - 1, max_items=7),
    delete(id_of(1)),
    register(1, boot=2**64 - 1),
    deregister(1),
    expire(1, registered_index=9, tenure=3),
    begin_tenure(4),
]
HOST = Host(
    host_id=id_of(1),
    name="rig",
    gatekeepers=(Endpoint(target="a:1"), Endpoint(target="unix:/b", zone="z")),
    boot_incarnation=5,
    version="0.1.0",
    alive=True,
    channels=3,
    registered_index=12,
)
CHANNEL = Channel(
    channel_id=id_of(2),
    name="cam",
    host_id=id_of(1),
    epoch=3,
    incarnation=2**64 - 1,
    policy=Policy(**EVERYTHING),
    policy_version=2,
    proxy_host_ids=(id_of(8),),
)
RESULTS: list[Result] = [
    Refused(reason="NO_HOST", message="none", metadata={"channel": "cam"}),
    ChannelOpened(channel=CHANNEL, host=HOST, created=True),
    ChannelUpdated(channel=CHANNEL),
    ChannelDeleted(channel=CHANNEL),
    HostRegistered(host=HOST, cluster_id="c"),
    HostDeregistered(),
    HostExpired(expired=True),
    TenureBegun(tenure=4, cluster_id="c"),
]


@pytest.mark.parametrize("deed", DEEDS, ids=lambda deed: type(deed).__name__)
def test_a_command_comes_out_as_it_went_in(deed: Deed) -> None:
    command = Command(op_id=id_of(3), time_unix_nano=-1, deed=deed)
    assert decode_command(encode_command(command)) == command


@pytest.mark.parametrize("result", RESULTS, ids=lambda result: type(result).__name__)
def test_a_result_comes_out_as_it_went_in(result: Result) -> None:
    assert decode_result(encode_result(result)) == result


def test_every_kind_of_command_and_result_is_covered() -> None:
    kinds = directory_command_pb2.DirectoryCommand.DESCRIPTOR.oneofs_by_name["kind"].fields
    outcomes = directory_command_pb2.DirectoryResult.DESCRIPTOR.oneofs_by_name["outcome"].fields
    assert len({type(deed) for deed in DEEDS}) == len(kinds)
    assert len(RESULTS) == len(outcomes)


def test_the_greatest_command_fits_the_log() -> None:
    widest = "x" * 256
    from dataclasses import replace

    deed = replace(register(1), gatekeepers=(Endpoint(target=widest, zone="z" * 64),) * 16, version="v" * 64)
    assert len(encode_command(Command(op_id=id_of(1), time_unix_nano=0, deed=deed))) < COMMAND_BYTES_MAX


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        (b"\xff\xff\xff", "INVALID_ARGUMENT"),
        (b"", "VERSION_MISMATCH"),
        (directory_command_pb2.DirectoryCommand(op_id=id_of(1)).SerializeToString(), "VERSION_MISMATCH"),
        (b"\xba\x3e\x02hi", "VERSION_MISMATCH"),  # a field of a newer version
    ],
)
def test_an_entry_that_cannot_be_read_is_refused_and_the_log_goes_on(entry: bytes, reason: str) -> None:
    replica = DirectoryReplica()
    result = decode_result(replica.apply(4, entry))
    assert isinstance(result, Refused)
    assert result.reason == reason
    assert replica.read(lambda directory: directory.applied_index) == 4


def test_an_unknown_way_to_be_full_is_refused() -> None:
    message = directory_command_pb2.DirectoryCommand(op_id=id_of(1))
    message.open_channel.name = "cam"
    message.open_channel.spec.on_full = 9  # type: ignore[assignment]
    result = decode_result(DirectoryReplica().apply(1, message.SerializeToString()))
    assert isinstance(result, Refused)
    assert "on_full" in result.message


def test_a_snapshot_of_another_form_is_not_taken_for_ours() -> None:
    with pytest.raises(VersionMismatch, match="format 2"):
        decode_snapshot(directory_command_pb2.DirectorySnapshot(format_version=2).SerializeToString())
