"""Sums up why no supernode served a call, in one error. Pure.

The result is the error of a supernode that answered, or an error that says that too few supernodes answer.
"""

from __future__ import annotations

from collections.abc import Mapping

from stampede_rt.errors import DeadlineExceeded, StampedeError, Unavailable, WrongCluster

UNREACHED = "unreached"
"""A key of an error's metadata. With this key the error means that the server could not be reached; the value says
why."""


def why_unserved(failures: Mapping[str, StampedeError], supernodes: int) -> StampedeError:
    """Return one error for a call that failed at the supernodes in `failures` (by address, the latest failure last).

    `supernodes` is the number of all supernodes; `failures` has at least one entry.
    """
    last = list(failures.values())[-1]
    ambiguous = [error for error in failures.values() if error.reason == "AMBIGUOUS"]
    if ambiguous:
        return ambiguous[-1]
    wrong_cluster_errors = [error for error in failures.values() if isinstance(error, WrongCluster)]
    if len(wrong_cluster_errors) == supernodes:
        return wrong_cluster_errors[-1]
    silent = {target: error for target, error in failures.items() if _is_silent(error)}
    needed = supernodes // 2 + 1
    if supernodes == 1 and silent:
        return last if isinstance(last, DeadlineExceeded) else _alone(*silent.items())
    if supernodes - len(silent) < needed:
        answering = f"{supernodes - len(silent)} of {supernodes} supernodes answer"
        missing = ", ".join(f"{target} {_failure_text(error)}" for target, error in silent.items())
        return Unavailable(
            f"the directory has no majority: {answering}, {needed} must answer ({missing}); start these with their "
            "folders; `stampede doctor` examines all supernodes",
            reason="NO_QUORUM",
        )
    answers = [error for target, error in failures.items() if target not in silent]
    return answers[-1] if answers else last


def _is_silent(error: StampedeError) -> bool:
    return isinstance(error, DeadlineExceeded | WrongCluster) or UNREACHED in error.metadata


def _failure_text(error: StampedeError) -> str:
    if isinstance(error, WrongCluster):
        named = f", {error.metadata['cluster_id']}" if "cluster_id" in error.metadata else ""
        return f"is of another cluster{named}"
    return "did not answer in time" if isinstance(error, DeadlineExceeded) else "cannot be reached"


def _alone(silent: tuple[str, StampedeError]) -> Unavailable:
    target, error = silent
    return Unavailable(
        f"the directory does not answer: its one supernode, {target}, cannot be reached ({error.metadata[UNREACHED]}); "
        "start it again, with its folder",
        reason="NO_QUORUM",
    )
