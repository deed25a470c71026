"""`stampede watch` after the supernodes have lost changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from queue import Queue
from typing import Any

from stampede_rt.cli.watching import Thing, _follow, _Source
from stampede_rt.errors import StampedeError, Unavailable, WatchRestart
from stampede_rt.values.model import Change, ChannelInfo, HostInfo, Policy


def channel(name: str, epoch: int = 1) -> ChannelInfo:
    return ChannelInfo(
        channel_id=name.encode(), name=name, host_id=b"h", host="host", host_alive=True, epoch=epoch, incarnation=1,
        policy=Policy(), spec_version=1,
    )  # fmt: skip


def watched(*watches: tuple[list[Thing], Sequence[Change | StampedeError]]) -> list[Any]:
    """The output of the command for some watches, one after the other. Each begins with a list."""
    remaining = iter(watches)
    listed: list[Thing] = []

    @contextmanager
    def watch(rt: Any, glob: str) -> Iterator[Iterator[Change]]:
        nonlocal listed
        listed, changes = next(remaining)

        def given_out() -> Iterator[Change]:
            for one in changes:
                if isinstance(one, StampedeError):
                    raise one
                yield one

        yield given_out()

    rows: Queue[Any] = Queue()
    listing: Callable[..., list[Thing]] = lambda rt, glob: listed  # noqa: E731
    _follow(None, "*", _Source(watch, listing), rows)  # type: ignore[arg-type]
    return [rows.get() for _ in range(rows.qsize())]


def test_after_a_restart_a_watch_reports_the_differences_and_continues() -> None:
    *rows, error = watched(
        ([channel("kept"), channel("gone"), channel("moved")], [
            Change(index=5, kind="added", subject=channel("late")), WatchRestart("begin anew")
        ]),
        ([channel("kept"), channel("moved", epoch=2), channel("new"), channel("late")], [
            Change(index=9, kind="removed", subject=channel("new")), Unavailable("the end")
        ]),
    )  # fmt: skip
    shown = [(row["change"], row["name"], row["index"]) for row in rows]
    assert shown == [
        ("added", "late", 5), ("removed", "gone", None), ("added", "new", None), ("updated", "moved", None),
        ("removed", "new", 9),
    ]  # fmt: skip
    assert isinstance(error, Unavailable)


def test_a_watch_reports_a_lost_host_but_not_a_changed_load() -> None:
    def host(alive: bool, channels: int) -> HostInfo:
        return HostInfo(host_id=b"h", name="host", endpoints=("a:1",), alive=alive, channels=channels, version="")

    changes = [Change(index=number, kind="updated", subject=host(number < 3, number)) for number in range(1, 5)]
    rows = watched(([host(True, 0)], [*changes, Unavailable("the end")]))[:-1]
    assert [(row["index"], row["alive"]) for row in rows] == [(3, False)]
