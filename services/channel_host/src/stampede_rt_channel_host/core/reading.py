"""Blocking reads."""

from __future__ import annotations

from stampede_rt.timeline import ResolvedInterval
from stampede_rt_channel_host.core.values import Query


class Pending:
    """A blocking get under way. Made by `Channel.begin`; `interval` is set once its anchors are resolved."""

    __slots__ = ("interval", "query")

    def __init__(self, query: Query, interval: ResolvedInterval | None) -> None:
        self.query = query
        self.interval = interval
