"""The supernodes that the client asks in one call to the directory: their order, and the time for each."""

import pytest

from stampede_rt.cluster.directory_call import (
    SUPERNODES_MAX,
    DirectoryCall,
    check_frontend,
    frontend_timeout_s,
    is_cut_short,
    leader_hint,
    may_pass,
)
from stampede_rt.cluster.majority import UNREACHED
from stampede_rt.errors import (
    ChannelNotFound,
    DeadlineExceeded,
    NotLeader,
    StampedeError,
    Unavailable,
    VersionMismatch,
)
from stampede_rt.version import PROTOCOL_VERSION


def unreached() -> StampedeError:
    return Unavailable("cannot be reached", metadata={UNREACHED: "refused"})


def round_targets(call: DirectoryCall, failures: dict[str, StampedeError], now_s: float = 0.0) -> list[str]:
    """The targets that one round asks, in order, if each target fails with its error in `failures`."""
    order: list[str] = []
    while (attempt := call.next_attempt(now_s)) is not None:
        order.append(attempt.target)
        call.note_failure(attempt.target, failures[attempt.target])
    return order


def test_a_round_asks_each_supernode_once_in_order() -> None:
    call = DirectoryCall(deadline_s=10.0)
    call.begin_round(["a", "b", "a", "c"], 2.5)
    assert round_targets(call, dict.fromkeys("abc", unreached())) == ["a", "b", "c"]


def test_a_call_asks_the_leader_that_a_supernode_names_next_and_only_once() -> None:
    call = DirectoryCall(deadline_s=10.0)
    call.begin_round(["a", "b", "c"], 2.5)
    names_c = NotLeader("c leads", metadata={"leader_endpoint": "c"})
    names_a = NotLeader("a leads", metadata={"leader_endpoint": "a"})
    assert round_targets(call, {"a": names_c, "b": names_c, "c": names_a}) == ["a", "c", "b"]


def test_a_call_follows_a_limited_number_of_leader_hints() -> None:
    call = DirectoryCall(deadline_s=10.0)
    call.begin_round(["0"], 2.5)
    names = {str(one): NotLeader("not me", metadata={"leader_endpoint": str(one + 1)}) for one in range(200)}
    assert len(round_targets(call, dict(names))) == SUPERNODES_MAX


def test_an_attempt_has_its_share_of_the_time_that_is_left() -> None:
    call = DirectoryCall(deadline_s=10.0)
    call.begin_round(["a", "b", "c"], 2.5)
    assert call.next_attempt(0.0) == ("a", 2.5)
    assert call.next_attempt(9.0) == ("b", 1.0)
    assert call.next_attempt(10.0) is None


def test_an_error_that_all_supernodes_would_give_ends_the_call() -> None:
    call = DirectoryCall(deadline_s=10.0)
    call.begin_round(["a", "b"], 2.5)
    call.next_attempt(0.0)
    with pytest.raises(ChannelNotFound):
        call.note_failure("a", ChannelNotFound("there is no channel cam"))


def test_a_missing_majority_is_inferred_from_the_failures_of_all_rounds() -> None:
    call = DirectoryCall(deadline_s=10.0)
    for target in "ab":
        call.begin_round([target], 2.5)
        round_targets(call, {target: unreached()})
    failure = call.failure(["a", "b", "c"])
    assert failure.reason == "NO_QUORUM"
    assert "1 of 3 supernodes answer" in failure.message


@pytest.mark.parametrize(
    ("now_s", "expected"),
    [(9.5, "its host is unreachable"), (5.0, "no majority")],
    ids=["too little time", "enough time"],
)
def test_an_attempt_with_too_little_time_does_not_hide_the_failure_of_an_earlier_attempt(
    now_s: float, expected: str
) -> None:
    call = DirectoryCall(deadline_s=10.0)
    for began_s, error in [
        (0.0, Unavailable("its host is unreachable", reason="NO_HOST")),
        (now_s, Unavailable("no majority", reason="NO_QUORUM")),
    ]:
        call.begin_round(["a"], float("inf"))
        round_targets(call, {"a": error}, began_s)
    assert call.failure(["a"]).message == expected


def test_an_error_says_that_no_attempt_had_enough_time() -> None:
    call = DirectoryCall(deadline_s=10.0)
    for now_s in (9.5, 9.9):
        call.begin_round(["a"], float("inf"))
        round_targets(call, {"a": Unavailable("no majority", reason="NO_QUORUM")}, now_s)
    assert is_cut_short(call.failure(["a"]), timeout_s=10.0)


def test_an_attempt_with_too_little_time_whose_update_may_be_done_is_told_and_marked() -> None:
    call = DirectoryCall(deadline_s=10.0)
    for now_s, error in [
        (0.0, Unavailable("its host is unreachable", reason="NO_HOST")),
        (9.9, Unavailable("perhaps done", reason="AMBIGUOUS")),
    ]:
        call.begin_round(["a"], float("inf"))
        round_targets(call, {"a": error}, now_s)
    assert call.failure(["a"]).reason == "AMBIGUOUS"
    assert is_cut_short(call.failure(["a"]), timeout_s=10.0)


def test_a_call_whose_time_is_over_before_it_begins_says_so() -> None:
    call = DirectoryCall(deadline_s=10.0)
    call.begin_round(["a"], 2.5)
    assert round_targets(call, {}, now_s=10.0) == []
    assert isinstance(call.failure(["a"]), DeadlineExceeded)


def test_without_a_supernode_the_error_names_the_service_to_start() -> None:
    assert "start a front-end and supernodes" in DirectoryCall(deadline_s=1.0).failure([]).message


def test_the_error_gives_the_reason_of_a_forgotten_supernode_if_it_has_no_other_reason() -> None:
    call = DirectoryCall(deadline_s=10.0)
    call.begin_round(["gone"], 2.5)
    round_targets(call, {"gone": unreached()})
    assert call.failure([]).metadata == {UNREACHED: "refused"}


@pytest.mark.parametrize(
    ("error", "passes"),
    [(unreached(), True), (DeadlineExceeded("late"), True), (ChannelNotFound("none"), False)],
)
def test_a_call_with_a_temporary_failure_is_tried_again(error: StampedeError, passes: bool) -> None:
    assert may_pass(error) is passes


def test_only_a_supernode_that_does_not_lead_names_the_leader() -> None:
    assert leader_hint(NotLeader("no", metadata={"leader_endpoint": "a:1"})) == "a:1"
    assert leader_hint(NotLeader("no")) == leader_hint(unreached()) == ""


def test_the_attempts_at_several_front_ends_share_the_time_of_the_call() -> None:
    assert [frontend_timeout_s(6.0, left) for left in (3, 2, 1)] == [2.0, 3.0, 6.0]
    assert frontend_timeout_s(-1.0, 2) == 0.1


def test_a_client_refuses_a_front_end_of_another_protocol() -> None:
    check_frontend("f:1", PROTOCOL_VERSION, "9.9", caller="client", caller_version="1.0")
    with pytest.raises(VersionMismatch, match="the front-end f:1 speaks protocol 99"):
        check_frontend("f:1", 99, "9.9", caller="client", caller_version="1.0")
