"""Percentiles, accounts by sequence number, and the figures that come of them."""

import pytest

from stampede_rt_demos.staging.statistics import Receipts, SequenceAccount, percentile
from stampede_rt_demos.tv_watcher.statistics import StepFigures, stream_figures


def step(*, video: int = 25) -> StepFigures:
    return StepFigures(
        time=0,
        end=1000,
        text="x",
        counts={"captions": 1, "video": video},
        complete=True,
        features_keep_times=True,
        received_unix_nano=1000,
    )


def test_percentiles_are_values_that_occurred():
    values = [5, 1, 4, 2, 3]
    assert [percentile(values, percent) for percent in (1, 50, 99, 100)] == [1, 3, 5, 5]


def test_no_values_have_no_percentile():
    assert percentile([], 50) is None


@pytest.mark.parametrize("percent", [0, -1, 101])
def test_a_percentile_out_of_range_is_refused(percent):
    with pytest.raises(ValueError, match="percentile"):
        percentile([1], percent)


def test_an_account_counts_skipped_and_repeated_items():
    account = SequenceAccount()
    for seq in (4, 5, 8, 8, 7, 9):
        account.add(seq)
    assert (account.received, account.missing, account.repeated, account.highest) == (4, 2, 2, 9)


def test_receipts_measure_from_put_to_receipt():
    receipts = Receipts()
    for seq, latency in enumerate([10, 30, 20]):
        receipts.add(seq=seq, payload_bytes=7, put_unix_nano=100, received_unix_nano=100 + latency)
    record = receipts.as_record()
    assert (record["received"], record["payload_bytes"]) == (3, 21)
    assert (record["latency_p50_nanos"], record["latency_p99_nanos"]) == (20, 30)


def test_items_that_the_host_accepted_and_the_reader_never_got_are_lost():
    receipts = Receipts()
    for seq in range(1, 48):
        receipts.add(seq=seq, payload_bytes=1, put_unix_nano=0, received_unix_nano=1)
    figures = stream_figures(
        "video",
        host="h1",
        accepted=50,
        receipts=receipts.as_record(),
        steps=[step(), step(video=22)],
        seconds=2,
    )
    assert figures.lost == 3
    assert figures.in_step == 47


def test_a_stream_of_which_nothing_came_has_no_latency():
    figures = stream_figures("video", host="h1", accepted=2, receipts=Receipts().as_record(), steps=[], seconds=2)
    assert (figures.lost, figures.latency_p50_nanos, figures.latency_p99_nanos) == (2, None, None)
