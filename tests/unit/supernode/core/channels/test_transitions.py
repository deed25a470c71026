"""The commands of channels, in a directory in memory."""

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt_supernode.core.channels import transitions
from stampede_rt_supernode.core.channels.commands import ChannelDeleted, ChannelOpened, ChannelUpdated
from stampede_rt_supernode.core.channels.policies import check_ranges
from stampede_rt_supernode.core.commands import RefusedOperation
from stampede_rt_supernode.core.queues.specs import check_queue_spec
from stampede_rt_supernode.core.records import QueueSpec
from tests.support.supernode.operations import Log, delete, deregister, id_of, open_channel, register, update


@pytest.fixture
def log() -> Log:
    log = Log()
    log.apply(register(1, name="one"))
    log.apply(register(2, name="two"))
    return log


def opened(log: Log, *args: str, **kwargs: object) -> ChannelOpened:
    result = log.apply(open_channel(*args, **kwargs))  # type: ignore[arg-type]
    assert isinstance(result, ChannelOpened), result
    return result


def refused(log: Log, *args: str, **kwargs: object) -> RefusedOperation:
    result = log.apply(open_channel(*args, **kwargs))  # type: ignore[arg-type]
    assert isinstance(result, RefusedOperation), result
    return result


def test_a_new_channel_is_placed_on_the_live_host_with_the_fewest_channels_and_the_first_name(log: Log) -> None:
    names = [opened(log, f"cam/{number}").host.name for number in range(4)]
    assert names == ["one", "two", "one", "two"]
    assert opened(log, "cam/here", host="two").host.channels == 3


def test_opening_again_gives_the_same_channel_and_does_not_create(log: Log) -> None:
    first = opened(log, "cam/left", max_age_nanos=10)
    repeated = opened(log, "cam/left", incarnation=5)
    assert (first.created, repeated.created) == (True, False)
    assert repeated.channel == first.channel
    assert (first.channel.epoch, first.channel.incarnation, first.channel.policy_version) == (1, 77, 1)


def test_create_false_refuses_an_absent_channel_and_names_a_remedy(log: Log) -> None:
    result = refused(log, "cam/left", create=False)
    assert result.reason == "CHANNEL_NOT_FOUND"
    assert "cam/left" in result.message
    assert "create=True" in result.message


def test_a_named_host_that_is_not_live_is_refused(log: Log) -> None:
    assert refused(log, "cam/left", host="three").reason == "HOST_NOT_FOUND"
    log.apply(deregister(2))
    assert refused(log, "cam/left", host="two").reason == "HOST_NOT_FOUND"


def test_a_channel_at_another_live_host_than_the_named_one_is_refused(log: Log) -> None:
    opened(log, "cam/left", host="one")
    assert opened(log, "cam/left", host="one").host.name == "one"
    result = refused(log, "cam/left", host="two")
    assert result.reason == "CHANNEL_EXISTS"
    assert "exists at host one, not at two" in result.message
    log.apply(deregister(1))
    assert opened(log, "cam/left", host="two").host.name == "two", "a lost owner is no contradiction"


def test_without_a_live_host_no_channel_can_be_opened() -> None:
    assert refused(Log(), "cam/left").reason == "NO_HOST"


def test_a_stated_field_that_contradicts_is_refused_and_the_error_names_both_values(log: Log) -> None:
    opened(log, "cam/left", max_age_nanos=10)
    result = refused(log, "cam/left", max_age_nanos=11)
    assert result.reason == "CHANNEL_EXISTS"
    assert "max_age 10 ns" in result.message
    assert "max_age 11 ns" in result.message
    assert result.metadata["field"] == "max_age_nanos"


def test_a_provisional_channel_takes_on_the_first_stated_policy_and_no_second_one(log: Log) -> None:
    provisional = opened(log, "cam/left").channel
    taken = opened(log, "cam/left", max_items=5, on_full="reject").channel
    assert taken.policy == Policy(max_items=5, on_full="reject")
    assert (taken.epoch, taken.incarnation) == (provisional.epoch, provisional.incarnation)
    assert taken.policy_version == provisional.policy_version + 1
    assert refused(log, "cam/left", max_items=6).reason == "CHANNEL_EXISTS"
    assert opened(log, "cam/left").channel == taken


def test_an_open_does_not_add_a_limit_that_the_channel_was_created_without(log: Log) -> None:
    opened(log, "cam/left", max_age_nanos=10)
    result = refused(log, "cam/left", max_items=1)
    assert result.reason == "CHANNEL_EXISTS"
    assert "left out" in result.message


def test_an_open_that_states_the_present_settings_agrees(log: Log) -> None:
    opened(log, "cam/left", max_age_nanos=10)
    agreed = opened(log, "cam/left", on_full="drop_oldest", max_future_nanos=10**9, content_type="image/png")
    assert agreed.channel.policy.content_type == "image/png"
    assert refused(log, "cam/left", content_type="image/jpeg").reason == "CHANNEL_EXISTS"
    assert refused(log, "cam/left", on_full="reject").reason == "CHANNEL_EXISTS"


@pytest.mark.parametrize(
    "policy",
    [
        {"max_age_nanos": 0},
        {"max_items": 0},
        {"max_bytes": 0},
        {"consumers": 0},
        {"max_future_nanos": -1},
        {"max_item_bytes": 2**24 + 1},
        {"on_full": "block"},
        {"on_full": "block", "max_items": 3},
        {"on_full": "explode"},
        {"content_type": "x" * 256},
    ],
)
def test_a_policy_out_of_range_is_refused_and_the_error_names_channel_and_field(
    log: Log, policy: dict[str, object]
) -> None:
    result = refused(log, "cam/left", **policy)
    assert result.reason == "INVALID_ARGUMENT"
    assert "cam/left" in result.message
    assert result.metadata["field"] in policy


@pytest.mark.parametrize("policy", [{"max_age_nanos": 1}, {"consumers": 1}])
def test_blocking_is_allowed_if_age_or_consumers_can_make_room(log: Log, policy: dict[str, object]) -> None:
    assert opened(log, "cam/left", on_full="block", **policy).created


@pytest.mark.parametrize("name", ["", "-cam", "/cam", "cam left", "cäm", "c" * 129, "cam\n"])
def test_a_name_outside_the_grammar_is_refused(log: Log, name: str) -> None:
    result = refused(log, name)
    assert result.reason == "INVALID_NAME"
    assert "a-z" in result.message


def test_names_that_differ_only_in_case_are_different_channels(log: Log) -> None:
    upper, lower = opened(log, "LSL/EEG_Amp").channel, opened(log, "lsl/eeg_amp").channel
    assert upper.channel_id != lower.channel_id


def test_the_longest_name_is_allowed(log: Log) -> None:
    assert opened(log, "0" + "a._/-b" * 21 + "z").created


def test_a_channel_of_a_lost_host_gets_a_new_owner_epoch_and_incarnation(log: Log) -> None:
    before = opened(log, "cam/left", host="one").channel
    log.apply(deregister(1))
    after = opened(log, "cam/left", incarnation=78, create=False)
    assert after.host.name == "two"
    assert not after.created
    assert (after.channel.channel_id, after.channel.epoch) == (before.channel_id, before.epoch + 1)
    assert after.channel.incarnation == 78
    assert id_of(1) not in log.directory.tables.hosts, (
        "the directory has no record of a host that owns nothing and is gone"
    )


def test_the_incarnation_changes_even_if_the_random_number_equals_the_old_one(log: Log) -> None:
    before = opened(log, "cam/left", host="one", incarnation=1).channel
    log.apply(deregister(1))
    after = opened(log, "cam/left", incarnation=1).channel
    assert after.incarnation not in (0, before.incarnation)


def test_a_channel_prefers_a_new_host_with_the_name_of_its_former_owner(log: Log) -> None:
    opened(log, "cam/left", host="two")
    opened(log, "cam/right", host="two")
    log.apply(deregister(2))
    log.apply(register(3, name="two"))
    opened(log, "filler", host="two")
    assert opened(log, "cam/left").host.host_id == id_of(3)


def test_an_update_changes_only_the_stated_fields_and_checks_the_whole_policy(log: Log) -> None:
    channel = opened(log, "cam/left", max_items=5).channel
    result = log.apply(update(channel.channel_id, channel.epoch, max_age_nanos=7))
    assert isinstance(result, ChannelUpdated)
    assert result.channel.policy == Policy(max_items=5, max_age_nanos=7)
    assert result.channel.policy_version == 2
    bad = log.apply(update(channel.channel_id, channel.epoch, on_full="nonsense"))
    assert isinstance(bad, RefusedOperation)


def test_whether_items_overlap_is_fixed_when_the_channel_is_created(log: Log) -> None:
    opened(log, "cam/left")
    assert refused(log, "cam/left", overlap_nanos=5).reason == "CHANNEL_EXISTS", (
        "the overlap is fixed even while the channel is provisional"
    )
    channel = opened(log, "scenes", overlap_nanos=5).channel
    assert (
        opened(log, "scenes").channel.policy == opened(log, "scenes", overlap_nanos=5).channel.policy == channel.policy
    )
    result = refused(log, "scenes", overlap_nanos=6)
    assert "configure()" not in result.message
    changed = log.apply(update(channel.channel_id, channel.epoch, overlap_nanos=6))
    assert isinstance(changed, RefusedOperation)
    assert "fixed" in changed.message
    assert isinstance(log.apply(update(channel.channel_id, channel.epoch, overlap_nanos=5)), ChannelUpdated)
    assert refused(log, "too/long", overlap_nanos=3_600_000_000_001).reason == "INVALID_ARGUMENT"


def test_an_update_under_another_epoch_is_refused(log: Log) -> None:
    channel = opened(log, "cam/left").channel
    result = log.apply(update(channel.channel_id, channel.epoch + 1, max_items=1))
    assert isinstance(result, RefusedOperation)
    assert result.reason == "WRONG_EPOCH"


def test_the_name_of_a_deleted_channel_can_be_used_again(log: Log) -> None:
    first = opened(log, "cam/left").channel
    assert isinstance(log.apply(delete(first.channel_id)), ChannelDeleted)
    repeated = log.apply(delete(first.channel_id))
    assert isinstance(repeated, RefusedOperation)
    assert repeated.reason == "CHANNEL_NOT_FOUND"
    second = opened(log, "cam/left", max_items=3)
    assert second.created
    assert second.channel.channel_id != first.channel_id


def test_the_number_of_channels_is_bounded(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transitions, "CHANNELS_MAX", 1)
    opened(log, "cam/left")
    assert refused(log, "cam/right").reason == "OVERLOADED"
    assert not opened(log, "cam/left").created


def test_a_duration_out_of_range_is_reported_as_callers_write_it() -> None:
    with pytest.raises(InvalidArgument) as caught:
        check_ranges("cam", Policy(overlap_nanos=7200 * 10**9))
    assert caught.value.message == "channel cam: overlap is 2 h; it must be more than 0 and at most 1 h"
    with pytest.raises(InvalidArgument) as caught:
        check_queue_spec("work", QueueSpec(lease_nanos=0))
    assert caught.value.message == "queue work: lease is 0 s; it must be more than 0"
