"""Random histories of owners that stop, crash and take over, with a store that fails at times: every item or LOST."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.values.timeline import Bound, Interval
from stampede_rt_channel_host.core.channel import Query, ReadAnswer
from tests.support.channel_host.object_stores import FakeStore
from tests.support.channel_host.recorded_hosts import Host, Owner, no_pauses_after_failures  # noqa: F401

HISTORIES, STEPS, EPOCHS = 60, 14, 6
LONG = 61 * 10**9
"""After this time a host closes its file."""

pytestmark = pytest.mark.usefixtures("no_pauses_after_failures")


class History:
    """One channel, and its owners. `times` are the times of all items. `steps` lists the steps for error texts."""

    free_places = "abc"
    """The hosts at which the next owner may be."""
    lacking = {"LOST"}
    """An answer that lacks items must have one of these reasons."""

    def __init__(self, path: Path, seed: int) -> None:
        self.path, self.dice = path, random.Random(seed)
        self.store = FakeStore()
        self.clock = 0
        self.times: list[int] = []
        self.steps: list[str] = []

    async def run(self) -> None:
        for epoch in range(1, EPOCHS + 1):
            await self._serve(epoch)

    async def _serve(self, epoch: int) -> None:
        """One owner, at one of three hosts, from its start to its end."""
        place = self.dice.choice(self.free_places)
        one = Host(self.path / place, self.store)
        one.clock = self.clock = self.clock + 1000
        self.store.failure = "unreachable" if epoch > 1 and self.dice.random() < 0.25 else ""
        self.steps.append(f"epoch {epoch} at {place}, store {self.store.failure or 'reachable'}")
        owner = await self._begin(Owner(one, epoch))
        for _ in range(self.dice.randrange(STEPS)):
            await self._step(owner)
        if self.dice.random() < 0.3:
            self.store.failure = ""
        self.clock = one.clock
        await self._end(owner)

    async def _begin(self, owner: Owner) -> Owner:
        """Let the owner begin."""
        return await owner.serve()

    async def _end(self, owner: Owner) -> None:
        """Stop or kill the owner."""
        is_clean = self.dice.random() < 0.5
        if is_clean:
            self.steps.append(f"stop, store {self.store.failure or 'reachable'}")
            await owner.recordings.close(0)
        else:
            self.steps.append("kill")
            owner.recording.recorder.files._end_segment()
            owner.host.archive.folder.close()

    async def _step(self, owner: Owner) -> None:
        what = self.dice.choice(["put", "put", "move", "lose store", "find store", "check"])
        if what == "put":
            time = owner.host.clock + 1
            self.times.append(time)
            self.steps.append(f"put {time}")
            await owner.put(time)
        elif what == "move":
            self.steps.append("move")
            owner.host.clock += LONG
            await owner.host.mover.move_all()
            await owner.host.mover.move_all()
        elif what == "check":
            await self._check(owner)
        else:
            self.store.failure = "unreachable" if what == "lose store" else ""
            self.steps.append(what)

    async def _check(self, owner: Owner) -> None:
        """Check that reads find only items that were put, each once, and that each read which lacks such an item
        says why.
        """
        found = await self._read(owner, 0, owner.host.clock) or []
        assert len(found) == len(set(found)), "\n".join(self.steps)
        assert set(found) <= set(self.times), "\n".join(self.steps)
        for time in [one for one in self.times if one not in found]:
            assert await self._read(owner, time, time) in (None, [time]), "\n".join(self.steps)
        for start in self.times[:: max(1, len(self.times) // 4)]:
            await self._check_subscription(owner, start)

    async def _check_subscription(self, owner: Owner, start: int) -> None:
        """Check that a subscription from `start` on gets each item once, and a gap if it lacks items. It gets no gap if
        a get lacks none.
        """
        query = _between(start, owner.host.clock)
        try:
            answer, (found, _) = await owner.read(query), await owner.subscribed(query.interval.start)
        except Unavailable:
            assert self.store.failure or owner.recording._unknown is not None, "\n".join(self.steps)
            return
        self.steps.append(f"subscribe from {start}: {found} {owner.gaps}, a get: {answer.reason}")
        wanted = [one for one in self.times if one >= start]
        assert found == [one for one in wanted if one in found], "\n".join(self.steps)
        has_rest = str(answer.reason) == "COLLECTED" and found == wanted[len(wanted) - len(found) :]
        assert found == wanted or owner.gaps or has_rest, "\n".join(self.steps)
        assert answer.reason or not owner.gaps, "\n".join(self.steps)

    async def _read(self, owner: Owner, start: int, end: int) -> list[int] | None:
        """The times of the items in an interval. None: the owner says that it cannot know them now, or LOST."""
        try:
            answer: ReadAnswer = await owner.read(_between(start, end))
        except Unavailable:
            assert self.store.failure or owner.recording._unknown is not None, "\n".join(self.steps)
            return None
        times = [time for one in answer.slices for time in one.run.times[one.lo : one.hi]]
        found = [one for one in times if start <= one <= end]  # the span of an earlier item may reach into it
        is_lost = answer.reason is not None and str(answer.reason) in self.lacking
        self.steps.append(f"read {start} to {end}: {found} {answer.reason}")
        return None if is_lost and not found else found


def _between(start: int, end: int) -> Query:
    return Query(interval=Interval(Bound(None, start), Bound(None, end)))


@pytest.mark.parametrize("seed", range(HISTORIES))
@pytest.mark.asyncio
async def test_no_item_is_lost_in_silence_doubled_or_invented(tmp_path: Path, seed: int) -> None:
    await History(tmp_path, seed).run()
