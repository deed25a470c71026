"""Reads of recorded channels through a group give the answers of a channel that has all items in memory."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.values.timeline import Match
from stampede_rt_channel_host.core.archive import archived_read
from stampede_rt_channel_host.core.channel import ReadAnswer
from stampede_rt_channel_host.core.group import Horizon, VisibleChannel
from tests.property.test_archive_against_memory import put_in_both, query_of, shown

SCENARIOS = 60
READS = 20


@pytest.fixture(autouse=True)
def small_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a read load one block or a few blocks in each window, and a few windows for each answer."""
    monkeypatch.setattr(archived_read, "FIRST_WINDOW_BYTES", 1)
    monkeypatch.setattr(archived_read, "WINDOW_BYTES", 300)
    monkeypatch.setattr(archived_read, "ANSWER_BYTES", 12)


def horizon_at(cut: int | None) -> Horizon:
    return Horizon(cut, lambda: "held back by nobody")


def drawn_cut(draw: random.Random, now: int) -> int | None:
    return None if draw.random() < 0.05 else draw.randrange(-1, now + 3)


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_group_read_over_an_archive_equals_one_over_memory(seed: int) -> None:
    draw = random.Random(seed)
    large, small, positions, now = put_in_both(draw, advances=draw.random() < 0.5)
    overlap = large.policy.overlap_nanos or 0
    for _ in range(READS):
        query, horizon = query_of(draw, now, positions), horizon_at(drawn_cut(draw, now))
        try:
            expected = VisibleChannel(large).read(query, horizon, small.now)
        except StampedeError as error:
            with pytest.raises(type(error)):
                small.read_in_group(query, horizon)
            continue
        assert shown(small.read_in_group(query, horizon), overlap) == shown(expected, overlap), (query, horizon.cut)


@pytest.mark.parametrize("seed", range(SCENARIOS))
def test_a_waiting_read_names_the_cut_that_releases_it_in_the_archive(seed: int) -> None:
    draw = random.Random(seed)
    large, small, positions, now = put_in_both(draw, advances=draw.random() < 0.5)
    memory = VisibleChannel(large)
    for _ in range(READS):
        query = replace(query_of(draw, now, positions), complete=draw.random() < 0.4)
        cut = drawn_cut(draw, now)
        try:
            pending = memory.begin(query, horizon_at(cut), small.now)
            found = memory.poll(pending, horizon_at(cut), small.now)
        except StampedeError as error:
            with pytest.raises(type(error)):
                small.view(query, horizon_at(cut))
            continue
        if isinstance(found, ReadAnswer) or pending.interval is None:
            continue
        release = small.view(query, horizon_at(cut)).released_by
        if release is None:
            continue
        assert cut is None or release > cut
        for between in {release - 1, draw.randrange(release - 1 if cut is None else cut, release)}:
            before = memory.poll(pending, horizon_at(between), small.now)
            assert not isinstance(before, ReadAnswer), (query, cut, between, release)
        if query.match is Match.START or query.complete:
            assert isinstance(memory.poll(pending, horizon_at(release), small.now), ReadAnswer), (query, cut, release)
