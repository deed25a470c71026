"""Repeating a request id repeats the answer, not the operation."""

import itertools

import pytest

from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core import kept_answers
from stampede_rt_supernode.core.channels.commands import ChannelDeleted, ChannelOpened
from stampede_rt_supernode.core.cluster.commands import MarkTime, RaiseFeatureLevel, TenureBegun, TimeMarked
from stampede_rt_supernode.core.cluster.feature_levels import GROUPS_AND_PEERS_LEVEL
from stampede_rt_supernode.core.commands import RefusedOperation, Result
from stampede_rt_supernode.core.kept_answers import (
    FORGOTTEN_BY_MARK,
    FORGOTTEN_PER_COMMAND,
    MARK_NANOS,
    MARKS_KEPT,
    REPEAT_NANOS_MAX,
)
from tests.support.supernode.operations import Log, begin_tenure, delete, id_of, open_channel, register


def test_a_repeated_operation_gets_the_same_answer_even_if_it_has_other_random_ids() -> None:
    log = Log()
    log.apply(register(1))
    first = log.apply(open_channel("cam"), op_id=id_of(1))
    repeated = log.apply(open_channel("cam"), op_id=id_of(1))
    assert isinstance(repeated, ChannelOpened)
    assert repeated == first
    assert repeated.created


def test_a_repeated_deletion_does_not_delete_a_new_channel_of_the_same_name() -> None:
    log = Log()
    log.apply(register(1))
    first = log.apply(open_channel("cam"))
    assert isinstance(first, ChannelOpened)
    gone = log.apply(delete(first.channel.channel_id), op_id=id_of(1))
    log.apply(open_channel("cam"))
    assert log.apply(delete(first.channel.channel_id), op_id=id_of(1)) == gone
    assert isinstance(gone, ChannelDeleted)
    assert "cam" in log.directory.tables.channel_ids


def test_a_refusal_is_not_kept_because_it_changed_nothing() -> None:
    log = Log()
    assert isinstance(log.apply(open_channel("cam"), op_id=id_of(1)), RefusedOperation)
    log.apply(register(1))
    assert isinstance(log.apply(open_channel("cam"), op_id=id_of(1)), ChannelOpened)


def test_a_request_id_used_for_something_else_is_refused() -> None:
    log = Log()
    log.apply(register(1), op_id=id_of(1))
    result = log.apply(open_channel("cam"), op_id=id_of(1))
    assert isinstance(result, RefusedOperation)
    assert result.reason == "INVALID_ARGUMENT"
    assert "request id" in result.message
    short = log.apply(open_channel("cam"), op_id=b"x")
    assert isinstance(short, RefusedOperation)
    assert "16" in short.message


def request_id(number: int) -> bytes:
    return id_of(2**32 + number)


def done(log: Log, number: int) -> Result:
    """Open a channel under the request id of that number. The supernode that asks the log has applied everything."""
    as_of_index = log.directory.applied_index
    return log.apply(open_channel(f"cam/{number}"), op_id=request_id(number), as_of_index=as_of_index)


def test_an_answer_is_kept_for_a_number_of_time_marks_after_any_number_of_commands() -> None:
    log = Log()
    log.apply(register(1))
    first = done(log, 1)
    for number in range(2, 20_000):
        done(log, number)
    assert done(log, 1) == first
    for _ in range(MARKS_KEPT - 1):
        assert log.mark_time() == TimeMarked(marked=True)
    assert done(log, 1) == first
    log.mark_time()
    assert request_id(1) not in {answer.op_id for answer in log.directory.kept_answers}


def test_an_answer_is_kept_for_longer_than_a_request_may_be_repeated() -> None:
    log = Log()
    log.apply(register(1))
    done = log.apply(open_channel("cam"), op_id=id_of(77))
    # The first mark may come immediately, and the request may be under way for one more mark.
    for _ in range(REPEAT_NANOS_MAX // MARK_NANOS + 2):
        log.mark_time()
        assert log.apply(open_channel("cam"), op_id=id_of(77)) == done


def test_each_command_drops_a_bounded_number_of_old_answers() -> None:
    log = Log()
    log.apply(register(1))
    for number in range(2 * FORGOTTEN_BY_MARK):
        done(log, number)
    for _ in range(MARKS_KEPT):
        log.mark_time()
    held = [len(log.directory.kept_answers)]
    for number in range(3):
        done(log, 10**6 + number)
        held.append(len(log.directory.kept_answers))
    assert [before - after for before, after in itertools.pairwise(held)] == [FORGOTTEN_PER_COMMAND - 1] * 3


def test_a_command_that_two_time_marks_have_overtaken_is_refused_without_effect() -> None:
    log = Log()
    log.apply(register(1))
    asked_index = log.directory.applied_index
    log.mark_time()
    assert isinstance(log.apply(open_channel("in-time"), as_of_index=asked_index), ChannelOpened)
    log.mark_time()
    late = log.apply(open_channel("late"), as_of_index=asked_index)
    assert isinstance(late, RefusedOperation)
    assert (late.reason, "within 30 s" in late.message) == ("AMBIGUOUS", True)
    assert "late" not in log.directory.tables.channel_ids
    assert isinstance(log.apply(open_channel("late"), as_of_index=log.directory.applied_index), ChannelOpened)


def test_a_command_whose_answer_was_dropped_is_not_performed_again() -> None:
    """Tries all moments at which a repetition is taken in and applied, up to 40 s of marks after the first time."""
    for applied_after in range(2 * MARKS_KEPT):
        for taken_in_after in range(min(applied_after + 1, MARKS_KEPT - 2)):
            log = Log()
            log.apply(register(1))
            opened = done(log, 1)
            assert isinstance(opened, ChannelOpened)
            log.apply(delete(opened.channel.channel_id))
            as_of = 0
            for number in range(applied_after + 1):
                as_of = log.directory.applied_index if number == taken_in_after else as_of
                if number < applied_after:
                    log.mark_time()
            repeated = log.apply(open_channel("cam/1"), op_id=request_id(1), as_of_index=as_of)
            assert repeated == opened or isinstance(repeated, RefusedOperation), (applied_after, taken_in_after)
            assert "cam/1" not in log.directory.tables.channel_ids


def test_a_time_mark_of_another_leader_or_a_repeated_one_has_no_effect() -> None:
    log = Log()
    assert log.mark_time(tenure=2) == TimeMarked(marked=False)
    repeated = MarkTime(tenure=1, after_index=0)
    assert [log.apply(repeated), log.apply(repeated)] == [TimeMarked(marked=True), TimeMarked(marked=False)]
    assert len(log.directory.kept_answers.marks) == 1


def test_a_command_whose_answer_cannot_be_kept_is_refused_without_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_answers, "BYTES_MAX", 4 * kept_answers.ANSWER_BYTES)
    log = Log()
    log.apply(register(1))
    assert [type(done(log, number)) for number in range(3)] == [ChannelOpened, ChannelOpened, RefusedOperation]
    full = done(log, 3)
    assert isinstance(full, RefusedOperation)
    assert full.reason == "OVERLOADED"
    assert isinstance(log.apply(begin_tenure(2)), TenureBegun)
    for _ in range(MARKS_KEPT):
        log.mark_time(tenure=2)
    assert isinstance(done(log, 3), ChannelOpened)


def test_a_snapshot_keeps_the_time_marks() -> None:
    log = Log()
    log.apply(register(1))
    done(log, 1)
    log.mark_time()
    restored = decode_snapshot(encode_snapshot(log.directory)).kept_answers
    assert (restored.marks, list(restored)) == (log.directory.kept_answers.marks, list(log.directory.kept_answers))


def test_one_caller_cannot_use_up_the_room_for_kept_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, one caller with very many changes in a minute made the directory refuse the updates of all
    callers.
    """
    monkeypatch.setattr(kept_answers, "CALLER_BYTES_MAX", 3 * kept_answers.ANSWER_BYTES)
    log = Log()
    log.apply(RaiseFeatureLevel(feature_level=GROUPS_AND_PEERS_LEVEL))
    log.apply(register(1))
    for number in range(3):
        assert isinstance(log.apply(open_channel(f"cam/{number}"), caller="greedy"), ChannelOpened)
    log.directory = decode_snapshot(encode_snapshot(log.directory))
    refused = log.apply(open_channel("cam/3"), caller="greedy")
    assert isinstance(refused, RefusedOperation)
    assert "answers to the updates of greedy in the last minute take 1536 bytes" in refused.message
    assert refused.metadata["subject"] == "greedy"
    for caller in ("good", ""):
        assert isinstance(log.apply(open_channel(f"good/{caller}"), caller=caller), ChannelOpened)
    for _ in range(MARKS_KEPT + 1):
        log.mark_time()
    assert isinstance(log.apply(open_channel("cam/3"), caller="greedy"), ChannelOpened)
