"""The error of a call that no supernode served."""

from __future__ import annotations

from stampede_rt.cluster.majority import UNREACHED, why_unserved
from stampede_rt.errors import DeadlineExceeded, StampedeError, Unavailable


def gone(target: str) -> Unavailable:
    return Unavailable(f"{target} cannot be reached", metadata={UNREACHED: "Connection refused"})


NO_MAJORITY = Unavailable("no majority of the supernodes answered within 2.0 s", reason="NO_QUORUM")


def error_text(failures: dict[str, StampedeError], supernodes: int = 3) -> str:
    error = why_unserved(failures, supernodes)
    assert isinstance(error, Unavailable | DeadlineExceeded)
    return f"{error.reason}: {error.message}"


def test_too_few_answers_mean_a_lost_majority_in_any_order_of_the_answers() -> None:
    for failures in (
        {"a": gone("a"), "b": NO_MAJORITY, "c": gone("c")},
        {"b": NO_MAJORITY, "a": gone("a"), "c": gone("c")},
    ):
        message = error_text(dict(failures))
        assert message.startswith(
            "NO_QUORUM: the directory has no majority: 1 of 3 supernodes answer, 2 must answer (a cannot be"
        )
        assert "address" not in message


def test_a_supernode_that_is_down_does_not_hide_the_answers_of_two_that_run() -> None:
    assert error_text({"a": gone("a"), "b": NO_MAJORITY, "c": gone("c")}, 5).startswith("NO_QUORUM: no majority of the")
    assert error_text({"b": NO_MAJORITY, "c": NO_MAJORITY, "a": gone("a")}).startswith("NO_QUORUM: no majority of the")


def test_a_silent_supernode_counts_as_one_that_is_down() -> None:
    message = error_text({"a": DeadlineExceeded("late"), "b": gone("b"), "c": gone("c")})
    assert "0 of 3 supernodes answer" in message
    assert "a did not answer in time, b cannot be reached" in message


def test_an_update_that_may_have_been_performed_is_never_reported_as_failed() -> None:
    unknown = Unavailable("nobody said whether it is done", reason="AMBIGUOUS")
    assert error_text({"a": unknown, "b": gone("b"), "c": gone("c")}).startswith("AMBIGUOUS")


def test_the_error_names_the_only_supernode_and_why_the_client_cannot_reach_it() -> None:
    message = error_text({"a:1": gone("a:1")}, 1)
    assert "its one supernode, a:1, cannot be reached (Connection refused); start it again" in message
    assert error_text({"a:1": DeadlineExceeded("a:1 did not answer in time")}, 1).startswith("DEADLINE_EXCEEDED")
