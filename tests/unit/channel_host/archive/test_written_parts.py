"""A run that joins the items of several puts goes to the archive as one run for each instant."""

from __future__ import annotations

from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host.archive.written_parts import by_instants
from stampede_rt_channel_host.copies.messages import run_of
from stampede_rt_channel_host.core.archive import ArchivedRun
from stampede_rt_channel_host.core.channel import AcceptedRows

JOINED = run_of(seal_run(encode_run([b"a", b"bb", b"c", b"d"], times=[1, 2, 3, 4], durations=[-1, 5, -1, -1]), 10))


def pieces(one: ArchivedRun) -> list[tuple[int, int, int, list[int]]]:
    found = [(part.accepted, part.run) for part in by_instants(one)]
    return [(accepted, run.first_seq, len(run), [*run.times]) for accepted, run in found]


def test_each_instant_has_a_run_of_its_own() -> None:
    rows = AcceptedRows((11, 13, 14), (100, 200, 300))
    assert pieces(ArchivedRun(100, JOINED, rows)) == [(100, 10, 1, [1]), (200, 11, 2, [2, 3]), (300, 13, 1, [4])]


def test_items_that_the_archive_has_are_left_out() -> None:
    rows = AcceptedRows((13, 14), (200, 300))
    assert pieces(ArchivedRun(200, JOINED, rows, 12)) == [(200, 12, 1, [3]), (300, 13, 1, [4])]


def test_the_parts_have_the_payloads_and_columns_of_their_items() -> None:
    _, middle = by_instants(ArchivedRun(1, JOINED, AcceptedRows((11, 14), (1, 2))))
    reread = run_of(bytes(middle.run.body))
    assert ([*reread.times], [*reread.lengths], [*(reread.durations or ())]) == ([2, 3, 4], [2, 1, 1], [5, -1, -1])
    assert bytes(middle.run.body).count(b"bbcd") == 1
