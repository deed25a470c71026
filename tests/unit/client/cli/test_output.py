"""Texts for people in the output of the command line."""

from __future__ import annotations

import pytest

from stampede_rt.cli.output import policy_text
from stampede_rt.values.model import Policy

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("policy", "text"),
    [
        (Policy(), "10 s (default)"),
        (Policy(overlap_nanos=5 * SECOND), "10 s (default), overlap 5 s"),
        (Policy(max_items=3, overlap_nanos=5 * SECOND), "3 items, overlap 5 s"),
        (Policy(max_age_nanos=60 * SECOND, max_age_unconsumed_nanos=3600 * SECOND), "1 m (to 1 h for consumers)"),
        (Policy(max_items=10, replicas=1), "10 items, 1 replica (ack host)"),
    ],
)
def test_the_text_of_a_policy_without_limits_names_the_default(policy: Policy, text: str) -> None:
    assert policy_text(policy) == text
