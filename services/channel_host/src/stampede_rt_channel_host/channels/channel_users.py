"""The callers that read and write a channel, in their protobuf form."""

from __future__ import annotations

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers
from stampede_rt_channel_host.core.channel import Pieces

READERS_SHOWN_MAX = 64


def users_of(hosted: HostedChannel, readers: Readers) -> Pieces[pb.ChannelUsers]:
    """The open subscriptions to the channel, the slowest first, and its latest writers, in pieces.

    Both lists are bounded.
    """
    slowest = yield from readers.of_channel(hosted.record.name, READERS_SHOWN_MAX)
    return pb.ChannelUsers(
        readers=[
            pb.ChannelReader(subscriber=one.subscriber, collected=one.collected, skipped=one.skipped) for one in slowest
        ],
        writers=[pb.ChannelWriter(name=name, last_put_unix_nano=time) for name, time in hosted.puts.writers()],
    )
