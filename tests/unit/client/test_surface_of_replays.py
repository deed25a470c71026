"""A replay has the public surface of the live handles: each name and parameter, or a stated reason why not."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest

from stampede_rt._async import connection as aio_connection
from stampede_rt._async import replay as aio_replay
from stampede_rt._sync.channel import Channel
from stampede_rt._sync.connection import Connection
from stampede_rt._sync.group import Group
from stampede_rt._sync.group_channel import GroupChannel
from stampede_rt._sync.matches import MatchSubscription
from stampede_rt._sync.past_matches import PastMatches
from stampede_rt._sync.replay import ReplayedConnection
from stampede_rt._sync.replayed_channel import ReplayedChannel
from stampede_rt._sync.replayed_group import ReplayedGroup, ReplayedGroupChannel
from stampede_rt._sync.replayed_matches import ReplayedMatches
from stampede_rt._sync.replayed_subscription import ReplayedNewest, ReplayedSubscription
from stampede_rt._sync.replayed_visible import ReplayedVisible
from stampede_rt._sync.subscription import Subscription
from stampede_rt.values.replaying import NOT_REPLAYED, not_replayed

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "recording.md").read_text()
PAIRS = [
    ("Connection", Connection, ReplayedConnection),
    ("Connection", aio_connection.Connection, aio_replay.ReplayedConnection),
    ("Channel", Channel, ReplayedChannel),
    ("Channel", GroupChannel, ReplayedGroupChannel),
    ("Group", Group, ReplayedGroup),
    ("Subscription", Subscription, ReplayedSubscription),
    ("Subscription", Subscription, ReplayedNewest),
    ("Subscription", Subscription, ReplayedVisible),
    ("MatchSubscription", MatchSubscription, ReplayedMatches),
    ("MatchSubscription", MatchSubscription, PastMatches),
]
SPECIAL = {"__getitem__", "__iter__", "__len__", "__next__", "__enter__", "__exit__", "__aenter__", "__aexit__"}
OTHER_NAMES = {"begin": "it makes the subscription"}  # names without an underscore that only the client uses
# Attributes of instances, which the tests of the handles use.
ATTRIBUTES = {
    "skipped",
    "dropped",
    "losses",
    "unmatched",
    "multicast",
    "reconnects",
}


def surface(kind: type) -> Iterator[tuple[str, list[str]]]:
    """The public names of a class, and the names of the parameters of each."""
    for name, member in inspect.getmembers(kind):
        if name in SPECIAL and getattr(object, name, None) is not member:
            yield name, []
        elif not name.startswith("_") and name not in OTHER_NAMES:
            found = list(inspect.signature(member).parameters) if callable(member) else []
            yield name, found


def missing_names(kind: str, live: type, replayed: type) -> list[str]:
    """The names and parameters that the replayed class lacks without a stated reason."""
    has, allowed = dict(surface(replayed)), NOT_REPLAYED.get(kind, {})
    found = []
    for name, parameters in surface(live):
        if name in allowed or name in ATTRIBUTES:
            continue
        taken = has.get(name)
        if taken is None:
            found.append(name)
        elif not {"stated"} & {*taken}:  # further arguments go to the connection's own check
            found += [f"{name}({one})" for one in parameters if one not in taken]
    return found


@pytest.mark.parametrize(("kind", "live", "replayed"), PAIRS)
def test_a_replayed_handle_has_each_name_of_the_live_one_or_a_reason_for_its_absence(
    kind: str, live: type, replayed: type
) -> None:
    assert missing_names(kind, live, replayed) == []


@pytest.mark.parametrize("kind", ["Connection", "Channel", "Group"])
def test_each_exception_names_a_live_name_and_is_on_the_page(kind: str) -> None:
    live = {"Connection": Connection, "Channel": Channel, "Group": Group}[kind]
    for name, why in NOT_REPLAYED[kind].items():
        assert hasattr(live, name) or name == "name"
        assert f"`{name}`" in PAGE, name
        assert why in str(not_replayed(kind, name, object()))


def test_a_method_that_a_replay_lacks_is_noticed() -> None:
    class Less(ReplayedGroup):
        newest = None  # type: ignore[assignment]

    assert "newest(payloads)" in missing_names("Group", Group, Less)
