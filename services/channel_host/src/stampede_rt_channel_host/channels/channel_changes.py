"""Performs changes of channels for callers: first in the directory, then at the host."""

from __future__ import annotations

import logging
from functools import partial

from stampede_rt.errors import ChannelNotFound
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.deletions import Deletions
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.hosted_copies import check_policy
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.directory import DirectoryQueries
from stampede_rt_channel_host.core.records import PolicyChange
from stampede_rt_runtime.access.control import check_access, current_account, own_name
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb

logger = logging.getLogger(__name__)


class ChannelChanges:
    """Deletes and configures the channels of a host."""

    def __init__(self, store: ChannelStore, directory: DirectoryQueries) -> None:
        self._store = store
        self._directory = directory
        self._deletions = Deletions()

    async def drop(self, channel_id: bytes, epoch: int, request_id: bytes, since_s: float) -> None:
        """Delete the channel in the directory and at this host. The streams of its readers end with CHANNEL_NOT_FOUND.

        Safe to repeat. `since_s`: when the caller made the request, in seconds of `request_age.age_clock_s`. Raises the
        errors of `bind`, and the errors that the directory answers.
        """
        if request_id in self._deletions:
            return
        hosted = await self._owned(channel_id, epoch, AccessVerb.DELETE)
        try:
            await self._directory.delete(channel_id, request_id=request_id, since_s=since_s)
        except ChannelNotFound:
            logger.info(
                "the channel is deleted already",
                extra={"event": "channel_already_deleted", "channel": hosted.record.name},
            )
        self._deletions.note(request_id, own_name())
        self._store.forget(channel_id, refusals.deleted(hosted.record.name))
        self._store.recordings.deleted(hosted.record)

    async def configure(
        self, channel_id: bytes, epoch: int, change: PolicyChange, request_id: bytes, since_s: float
    ) -> HostedChannel:
        """Change the policy in the directory, then at this host. Safe to repeat. `change`: the fields to change.

        Raises the errors of `bind`, InvalidArgument for a policy that no channel can have, and the errors that the
        directory answers.
        """
        hosted = await self._owned(channel_id, epoch, AccessVerb.CONFIGURE)
        self._store.recordings.check_change(hosted.record, change.stated)  # before the directory takes it
        version = partial(self._store.version_of, channel_id)
        before = version()
        record = await self._directory.update(channel_id, epoch, change, request_id=request_id, since_s=since_s)
        if before != version():  # the answer may be older than the channel's present owner
            return await self._store.bind(channel_id, record.epoch, record.spec_version)
        changed = await self._store.recordings.adopt(record, hosted, self._store.adopt, version)
        check_policy(changed, record.spec_version)
        return changed

    async def _owned(self, channel_id: bytes, epoch: int, verb: AccessVerb) -> HostedChannel:
        """The channel that this host owns, if the caller may make this change. Raises the errors of `bind`."""
        await self._store.bind(channel_id, epoch)
        hosted = self._store.find(channel_id, epoch)  # finds only channels that this host owns, not copies
        check_access(verb, AccessKind.CHANNEL, hosted.record.name)
        current_account().change()
        return hosted
