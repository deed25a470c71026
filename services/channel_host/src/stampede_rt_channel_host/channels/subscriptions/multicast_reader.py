"""The reader of a subscription that may take its items from datagrams: its offer, and its repairs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.multicast.channel_multicast import ChannelMulticast
from stampede_rt_channel_host.channels.multicast.multicasts import Multicasts
from stampede_rt_channel_host.channels.requests import is_newest


def offers_multicast(opening: pb.SubscribeOpen, multicasts: Multicasts | None) -> bool:
    """Whether the host offers multicast to the reader of this subscription."""
    is_wanted = opening.multicast and not (
        opening.without_payloads or opening.HasField("group_id") or is_newest(opening)
    )
    return is_wanted and multicasts is not None


class MulticastReader:
    """A reader's part in multicast. Most readers take no datagrams. For them this object does nothing."""

    def __init__(self) -> None:
        self._multicasts: Multicasts | None = None
        self._channel: ChannelMulticast | None = None
        self._announced_key = 0
        self.repair_bytes = 0  # the most bytes of the last requested repair
        self._repair_seq: int | None = None  # the first seq of a requested repair, until the repair begins
        self._owed_seq: int | None = None  # the first seq of a repair, until the reader has the answer

    @contextmanager
    def joined(self, multicasts: Multicasts | None, hosted: HostedChannel, opening: pb.SubscribeOpen) -> Iterator[None]:
        """Multicast the channel during the block, if the reader wants it."""
        if multicasts is None or not offers_multicast(opening, multicasts):
            yield
            return
        with multicasts.reading(hosted) as self._channel:
            self._multicasts = multicasts
            yield

    def request_repair(self, request: pb.SubscribeRequest) -> None:
        """Note that the reader requests the items from a seq on. Raises InvalidArgument without an offer."""
        if self._channel is None or self._multicasts is None:
            raise InvalidArgument("repair_next_seq is set, and the host has offered no multicast; leave it out")
        self._channel.repairs += 1
        self._multicasts.repairs += 1
        self._repair_seq, self.repair_bytes = max(1, request.repair_next_seq), max(1, request.credit_bytes)

    def begin_repair(self, incarnation: int) -> pb.SubscribeOpen:
        """Begin the requested repair. Returns an opening with the cursor at which the repair begins.

        Call this only if `has_repair_request`.
        """
        assert self._repair_seq is not None, "the reader has asked for a repair"
        self._owed_seq, self._repair_seq = self._repair_seq, None
        cursor = pb.SubscriptionCursor(incarnation=incarnation, next_seq=self._owed_seq)
        return pb.SubscribeOpen(mode=pb.SUBSCRIBE_MODE_ALL, cursor=cursor)

    @property
    def is_joined(self) -> bool:
        """Whether the reader has an offer."""
        return self._channel is not None

    @property
    def has_repair_request(self) -> bool:
        """Whether the reader has requested a repair that has not begun yet."""
        return self._repair_seq is not None

    @property
    def is_owed(self) -> bool:
        """Whether the next response answers a repair. Then the host sends nothing after it."""
        return self._owed_seq is not None

    def encoded_fields(self) -> bytes:
        """The encoded fields of the next response: the answer to a repair, and the offer if the key is a new one."""
        if self._channel is None:
            return b""
        response = pb.SubscribeResponse(repair_next_seq=self._owed_seq)
        self._owed_seq = None
        offer = self._channel.offer
        if offer.key_number != self._announced_key:
            self._announced_key = offer.key_number
            response.multicast.CopyFrom(
                pb.MulticastOffer(
                    group=offer.group, stream_id=offer.stream_id, key_number=offer.key_number, key=offer.key,
                    public_key=offer.public_key,
                )
            )  # fmt: skip
        return response.SerializeToString()
