"""Random histories of owners that also move the channel to the next owner: every item, or the reason why not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shutil import rmtree

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from tests.support.channel_host.recorded_hosts import Owner, no_pauses_after_failures, record  # noqa: F401
from tests.unit.channel_host.channels.test_recordings_random_stops import HISTORIES, LONG, History

pytestmark = pytest.mark.usefixtures("no_pauses_after_failures", "no_wait_for_former_files")


@pytest.fixture
def no_wait_for_former_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no read wait for the files of a former owner, which may never come."""
    monkeypatch.setattr("stampede_rt_channel_host.archive.former_files.WAIT_SECONDS_MAX", 0.0)


class MovingHistory(History):
    """A history in which an owner may move the channel to the next one. Its last files come later."""

    lacking = {"LOST", "COLLECTED"}  # COLLECTED: if the store has no earlier file yet
    former: Owner | None = None
    incarnation = 0  # the incarnation of the channel at the present owner

    async def _end(self, owner: Owner) -> None:
        if self.dice.random() < 0.6:
            self.former = owner
            self.free_places = "abc".replace(owner.host.path.name, "")
        else:
            await super()._end(owner)

    async def _begin(self, owner: Owner) -> Owner:
        former, self.former, self.free_places = self.former, None, "abc"
        if former is None or not await self._has_moved(former, owner):
            self.incarnation = owner.epoch
            return await super()._begin(owner)
        return owner

    async def _has_moved(self, former: Owner, owner: Owner) -> bool:
        """Move the channel. If the store is away, the former owner is killed instead."""
        core, moved = former.hosted.core, replace(record(owner.epoch), incarnation=self.incarnation)
        try:
            former.recording.check_movable()
            await owner.recordings.prepare_move(replace(moved, epoch=former.epoch), core.next_seq)
        except Unavailable:
            self.steps.append("no move: kill")
            await super()._end(former)
            return False
        self.steps.append("move here")
        moved = replace(moved, policy=former.hosted.record.policy)
        hosted = HostedChannel(moved, MemoryBudget(2**30), owner.now)
        runs = [one.run for one in core.accepted_from(0)]
        loss = (core.lost_from, core.lost_before)
        hosted.core.restore(runs, after=core.held.newest_collected, next_seq=core.next_seq, loss=loss)
        hosted.begin_move()
        owner.keep(await owner.recordings.adopt(moved, None, lambda _: hosted))
        hosted.end_move()
        hosted.changed(owner.now())
        await owner.host.archive.write_all()
        await self._leave(former)
        return True

    async def end(self) -> None:
        """End the last owner, if the channel was to move from it."""
        if self.former is not None:
            await super()._end(self.former)

    async def _leave(self, former: Owner) -> None:
        """Let the former owner give the channel up, and perhaps move its last file before it is killed."""
        former.host.archive.forget(former.recording.recorder)
        if self.dice.random() < 0.6:
            former.host.clock += LONG
            await former.host.mover.move_all()
            await former.host.mover.move_all()
        former.host.archive._writer.shutdown()
        former.host.archive.folder.close()
        if self.dice.random() < 0.3:
            self.steps.append("the disk of the former owner is lost")
            rmtree(former.host.path)


@pytest.mark.parametrize("seed", range(HISTORIES))
@pytest.mark.asyncio
async def test_no_item_is_lost_in_silence_doubled_or_invented(tmp_path: Path, seed: int) -> None:
    history = MovingHistory(tmp_path, seed)
    await history.run()
    await history.end()
