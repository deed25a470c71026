"""Raises the cluster's feature level as soon as all members know a higher level, while this supernode leads."""

from __future__ import annotations

import asyncio
import logging
import secrets

from stampede_rt.errors import StampedeError
from stampede_rt_supernode.core.cluster.commands import FeatureLevelRaised, RaiseFeatureLevel
from stampede_rt_supernode.core.records import ID_BYTES
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReplicatedLog
from stampede_rt_supernode.servicers.submission import Submission

logger = logging.getLogger(__name__)

TICK_SECONDS = 0.5
# The longest time that a tick waits for the outcome of its command.
PROPOSAL_SECONDS = 5.0


class LevelKeeper:
    """Raises the feature level. Call `tick` again and again, on the event loop."""

    def __init__(self, log: ReplicatedLog, replica: DirectoryReplica, submission: Submission) -> None:
        self._log = log
        self._replica = replica
        self._submission = submission

    async def run(self) -> None:
        """Tick until cancelled."""
        while True:
            await self.tick()
            await asyncio.sleep(TICK_SECONDS)

    async def tick(self) -> None:
        """If this supernode leads and its tenure has begun, raise the level to the highest that all members know.

        The next tick repeats a failed attempt.
        """
        status = self._log.status()
        level = status.level_of_members
        tenure = self._replica.read(lambda directory: directory.tenure)
        if not (status.is_leader and tenure == status.tenure > 0 and level > self._replica.feature_level):
            return
        operation = RaiseFeatureLevel(feature_level=level, tenure=tenure)
        try:
            raised = await self._submission.submit(
                operation, FeatureLevelRaised, op_id=secrets.token_bytes(ID_BYTES), seconds=PROPOSAL_SECONDS
            )
        except StampedeError as error:
            logger.warning(
                "the feature level could not be raised yet",
                extra={"event": "feature_level_waits", "reason": error.reason, "cause": error.message},
            )
        else:
            logger.info(
                "the feature level is raised, because all supernodes know the higher level",
                extra={"event": "feature_level_raised", "feature_level": raised.feature_level},
            )
