"""The archive of a channel in `stampede info`."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.cli.archive_facts import archive_facts
from stampede_rt.values.statistics import ArchiveStats
from tests.unit.client.cli.test_channel_rates import STATS

COMPLETE = ArchiveStats(
    items=1, bytes=2048, disk_bytes=2048, oldest=0, newest=0, waiting=0, unarchived=0, place="/data", failure=""
)
INCOMPLETE = replace(
    COMPLETE, items=2, disk_bytes=1024, newest=None, waiting=3, unarchived=1, failure="No space left on device"
)


def test_the_table_names_the_items_of_the_archive_and_its_place() -> None:
    facts = archive_facts(replace(STATS, archive=COMPLETE), for_people=True)
    first = "1970-01-01T00:00:00.000000000Z"
    assert facts == {"archive": f"1 item (2.0 KiB), from {first} to {first}", "archive_place": "/data"}


def test_the_table_names_everything_that_the_archive_lacks() -> None:
    facts = archive_facts(replace(STATS, archive=INCOMPLETE), for_people=True)
    assert facts["archive"] == (
        "2 items (2.0 KiB), 1.0 KiB of it on the host's disk, 3 items not on the disk yet, "
        "1 item collected by max_bytes before the disk had them, fails: No space left on device"
    )


def test_the_json_output_has_plain_values() -> None:
    assert archive_facts(replace(STATS, archive=INCOMPLETE), for_people=False)["archive"]["unarchived"] == 1
    assert archive_facts(STATS, for_people=False) == {"archive": None}
    assert archive_facts(STATS, for_people=True) == {"archive": "none"}
