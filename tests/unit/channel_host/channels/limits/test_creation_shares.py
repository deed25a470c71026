"""One caller cannot take up all the channels or queues that a host serves."""

from __future__ import annotations

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.limits.creation_shares import CreationShares


def test_one_caller_may_use_three_quarters_of_a_limit_and_others_the_rest() -> None:
    here = CreationShares("h1", "channels", 8)
    for _ in range(6):
        here.check("greedy")
        here.note("greedy", +1)
    with pytest.raises(Overloaded, match="host h1 serves 6 channels that greedy has created, the most for one caller"):
        here.check("greedy")
    here.check("good")
    here.note("greedy", -1)
    here.check("greedy")


def test_a_name_that_several_callers_use_has_no_limit() -> None:
    here = CreationShares("h1", "queues", 4)
    for name in ("", "@clients", "@cluster"):
        for _ in range(9):
            here.check(name)
            here.note(name, +1)
