"""Repeating a request id repeats the answer, not the deed."""

from stampede_rt_supernode.core.answered import WINDOW_INDEXES
from stampede_rt_supernode.core.commands import ChannelDeleted, ChannelOpened, Command, Refused
from tests.unit.supernode.deeds import Log, begin_tenure, delete, id_of, open_channel, register


def test_a_repeated_operation_gives_the_same_answer_although_other_ids_were_drawn_for_it() -> None:
    log = Log()
    log.apply(register(1))
    first = log.apply(open_channel("cam"), op_id=id_of(1))
    again = log.apply(open_channel("cam"), op_id=id_of(1))
    assert isinstance(again, ChannelOpened)
    assert again == first
    assert again.created


def test_a_repeated_deletion_does_not_hit_the_next_channel_of_that_name() -> None:
    log = Log()
    log.apply(register(1))
    first = log.apply(open_channel("cam"))
    assert isinstance(first, ChannelOpened)
    gone = log.apply(delete(first.channel.channel_id), op_id=id_of(1))
    log.apply(open_channel("cam"))
    assert log.apply(delete(first.channel.channel_id), op_id=id_of(1)) == gone
    assert isinstance(gone, ChannelDeleted)
    assert "cam" in log.directory.tables.channel_ids


def test_a_refusal_is_not_remembered_since_it_changed_nothing() -> None:
    log = Log()
    assert isinstance(log.apply(open_channel("cam"), op_id=id_of(1)), Refused)
    log.apply(register(1))
    assert isinstance(log.apply(open_channel("cam"), op_id=id_of(1)), ChannelOpened)


def test_a_request_id_used_for_something_else_is_refused() -> None:
    log = Log()
    log.apply(register(1), op_id=id_of(1))
    result = log.apply(open_channel("cam"), op_id=id_of(1))
    assert isinstance(result, Refused)
    assert result.reason == "INVALID_ARGUMENT"
    assert "request id" in result.message
    short = log.apply(open_channel("cam"), op_id=b"x")
    assert isinstance(short, Refused)
    assert "16" in short.message


def test_operations_are_forgotten_once_the_log_has_gone_on_far_enough() -> None:
    log = Log(founded=False)
    directory = log.directory
    directory.apply(1, Command(op_id=id_of(1), time_unix_nano=0, deed=begin_tenure(1)))
    directory.apply(WINDOW_INDEXES, Command(op_id=id_of(2), time_unix_nano=0, deed=begin_tenure(2)))
    assert len(directory.answered) == 2
    directory.apply(WINDOW_INDEXES + 1, Command(op_id=id_of(3), time_unix_nano=0, deed=begin_tenure(3)))
    assert [answer.op_id for answer in directory.answered] == [id_of(2), id_of(3)]
