"""The metrics of the groups that a host knows, made in pieces."""

from __future__ import annotations

from collections.abc import Callable
from heapq import nlargest

from stampede_rt_channel_host.core.channel import Pieces, batched
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_channel_host.metrics import catalog
from stampede_rt_channel_host.metrics.catalog import HOLDERS_MAX, NAMES_MAX
from stampede_rt_runtime.metrics.families import Family

GROUPS_PER_PIECE = 64
HOLDERS_PER_PIECE = 4
"""One piece has fewer groups with metrics of their own, because such a group looks at all its members."""


class GroupMetrics:
    """The metrics of the groups of one host. `shows` returns whether a group may have metrics of its own."""

    def __init__(self, groups: GroupStore, shows: Callable[[str], object]) -> None:
        self._groups = groups
        self._shows = shows

    def families(self) -> Pieces[list[Family]]:
        """All metrics. The groups with the greatest lags have metrics of their own."""
        now, lags, without, known = self._groups.channels.now(), [0.0], 0, self._groups.all()
        shown: list[tuple[float, str, HostedGroup]] = []
        for part in batched(known, GROUPS_PER_PIECE):
            for group in part:
                if group.cut.cut is None:
                    without += 1
                    continue
                lags.append((now - group.cut.cut) / 1e9)
                if self._shows(group.record.name):
                    shown.append((lags[-1], group.record.name, group))
            yield
        worst = nlargest(NAMES_MAX, shown, key=lambda one: one[:2])
        held_by: list[tuple[tuple[str, ...], float]] = []
        for few in batched(worst, HOLDERS_PER_PIECE):
            for _, name, group in few:
                held_by += (((name, group.name_of(one)), 1.0) for one in group.waiting_on()[:HOLDERS_MAX])
            yield
        return [
            catalog.GROUPS.of(len(known)),
            catalog.GROUPS_WITHOUT_CUT.of(without),
            catalog.CUT_LAG_MAX.of(max(lags)),
            catalog.CUT_LAG.family(((name,), lag) for lag, name, _ in sorted(worst, key=lambda one: one[1])),
            catalog.CUT_HELD_BY.family(held_by),
        ]
