"""The facts that a handle keeps about its channel."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.values.codecs import HandleCodec
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.wire.decoding import ItemDecoder


@dataclass(slots=True)
class ChannelState:
    """The facts that a handle keeps about its channel.

    `info` is the directory's latest description, and `cluster_id` the cluster of that directory. `stated` and `create`
    are the arguments with which the handle opens the channel again.
    """

    info: ChannelInfo
    stated: Policy
    create: bool
    coding: HandleCodec | None = None
    cluster_id: str = ""

    def decoder(self, incarnation: int, *, payloads: bool) -> ItemDecoder:
        """Return a decoder that turns the host's runs into Items."""
        policy = self.info.policy
        return ItemDecoder(
            incarnation=incarnation,
            content_type=policy.content_type or "",
            payloads=payloads,
            coding=self.coding,
            overlap_nanos=policy.overlap_nanos or 0,
        )
