"""The readers and writers of a channel in `stampede info`."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.cli.channel_users import NOT_KNOWN, user_facts
from stampede_rt.values.statistics import ReaderStats, WriterStats
from tests.unit.client.cli.test_channel_rates import STATS, S

REPORTED = replace(
    STATS,
    dropped=7,
    readers=[
        ReaderStats(subscriber="dash#3", collected=5, skipped=2),
        ReaderStats(subscriber="@localhost#1", collected=0, skipped=0),
    ],
    writers=[WriterStats(name="cam", last_put=98 * S)],
)


def test_the_table_has_the_missed_items_of_each_reader_and_the_last_put_of_each_writer() -> None:
    assert user_facts(REPORTED, for_people=True) == {
        "dropped": 7,
        "readers": "dash#3 (5 collected, 2 skipped), @localhost#1",
        "writers": "cam (2 s ago)",
    }


def test_the_table_shows_whether_names_are_unknown_or_there_are_none() -> None:
    assert user_facts(STATS, for_people=True) == {"dropped": 0, "readers": NOT_KNOWN, "writers": NOT_KNOWN}
    assert user_facts(STATS, for_people=False) == {"dropped": 0, "readers": None, "writers": None}
    nobody = replace(STATS, readers=(), writers=())
    assert user_facts(nobody, for_people=True) == {"dropped": 0, "readers": "none", "writers": "none"}


def test_the_json_output_has_plain_values() -> None:
    facts = user_facts(REPORTED, for_people=False)
    assert facts["readers"][0] == {"subscriber": "dash#3", "collected": 5, "skipped": 2}
    assert facts["writers"] == [{"name": "cam", "last_put": 98 * S}]
