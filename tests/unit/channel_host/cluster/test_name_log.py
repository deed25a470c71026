"""Names that come together share a line of the log."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator

import pytest

from stampede_rt_channel_host.cluster.name_log import GATHER_SECONDS, NAMES_MAX, NameLog
from tests.support.virtual_time import VirtualClock, run_virtually

LOGGER = logging.getLogger("test_name_log")


class Lines(logging.Handler):
    """The facts of each line: the event, the channel, the channels, and their number."""

    def __init__(self) -> None:
        super().__init__()
        self.facts: list[tuple[object, ...]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.facts.append(tuple(vars(record).get(key) for key in ("event", "channel", "channels", "count")))


@pytest.fixture
def lines() -> Iterator[list[tuple[object, ...]]]:
    handler = Lines()
    LOGGER.setLevel(logging.INFO)
    LOGGER.addHandler(handler)
    yield handler.facts
    LOGGER.removeHandler(handler)


def test_a_lone_name_has_its_line_immediately(lines: list[tuple[object, ...]]) -> None:
    async def main(_: VirtualClock) -> None:
        log = NameLog(LOGGER, "channel", "moved here", event="channel_moved_here")
        log.note("a")
        assert lines == [("channel_moved_here", "a", None, None)]
        await asyncio.sleep(2 * GATHER_SECONDS)
        log.note("b")
        assert lines[1] == ("channel_moved_here", "b", None, None)
        log.close()

    run_virtually(main, seed=1)
    assert len(lines) == 2


def test_the_names_of_a_short_time_share_a_line(lines: list[tuple[object, ...]]) -> None:
    async def main(_: VirtualClock) -> None:
        log = NameLog(LOGGER, "channel", "moved here", event="channel_moved_here")
        for name in "abc":
            log.note(name)
        assert len(lines) == 1
        await asyncio.sleep(1.5 * GATHER_SECONDS)
        assert lines[1] == ("channel_moved_here", None, "b, c", 2)
        log.note("d")
        assert len(lines) == 2
        await asyncio.sleep(GATHER_SECONDS)
        assert lines[2] == ("channel_moved_here", "d", None, None)

    run_virtually(main, seed=1)


def test_a_line_has_a_limited_number_of_names(lines: list[tuple[object, ...]]) -> None:
    async def main(_: VirtualClock) -> None:
        log = NameLog(LOGGER, "channel", "moved here", event="channel_moved_here")
        for number in range(2 * NAMES_MAX + 4):
            log.note(str(number))
        assert [one[3] for one in lines] == [None, NAMES_MAX, NAMES_MAX]
        log.close()
        assert lines[3][3] == 3

    run_virtually(main, seed=1)
