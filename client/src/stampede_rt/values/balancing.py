"""Plans moves that even out the loads of hosts. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

DIFFERENCE_PERMILLE_MIN = 100
"""Hosts whose loads differ by less than this stay as they are: a tenth of a core."""
MOVES_MAX = 1000  # the most moves of one plan


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedMove:
    """A move that would even out the loads of two hosts. `busy_permille`: about how much of a core the channel uses."""

    channel: str
    source: str
    host: str
    busy_permille: int


@dataclass(frozen=True, slots=True)
class _ChannelSet:
    names: Sequence[str]
    host: str
    busy: float


def plan_moves(
    busy: Mapping[str, int],
    rates: Mapping[str, Mapping[str, float]],
    groups: Iterable[Collection[str]],
    staying: Collection[str] = (),
) -> list[PlannedMove]:
    """Plan moves from the busiest hosts to the least busy ones, until their loads differ little.

    `busy`: by host, the thousandths of a core that it uses, as it last reported. `rates`: by host and channel, the work
    of the channel; the host's load is divided among its channels in this proportion. `groups`: the channels of each
    group. Channels of one group at one host move together. `staying`: channels that cannot move.
    """
    shares = {
        name: busy[host] * rate / (sum(channels.values()) or 1.0)
        for host, channels in rates.items()
        for name, rate in channels.items()
    }
    sets = [
        _ChannelSet(names, host, sum(shares[name] for name in names))
        for host, channels in rates.items()
        for names in _connected_sets(channels, groups)
        if not any(name in staying for name in names)
    ]
    return _even_out({host: float(permille) for host, permille in busy.items()}, sets, shares)


def _even_out(load: dict[str, float], sets: list[_ChannelSet], shares: Mapping[str, float]) -> list[PlannedMove]:
    planned: list[PlannedMove] = []
    while len(planned) < MOVES_MAX and len(load) > 1:
        most, least = max(load, key=load.__getitem__), min(load, key=load.__getitem__)
        best = _best(sets, most, load[most] - load[least])
        if best is None:
            break
        load[most] -= best.busy
        load[least] += best.busy
        sets.remove(best)  # a channel moves once at most
        planned += [
            PlannedMove(channel=name, source=most, host=least, busy_permille=round(shares[name])) for name in best.names
        ]
    return planned


def _best(sets: Iterable[_ChannelSet], host: str, gap: float) -> _ChannelSet | None:
    """The set of the host's channels that comes nearest to half of the gap between two loads; None: no set makes the
    gap smaller.
    """
    if gap < DIFFERENCE_PERMILLE_MIN:
        return None
    fitting = (one for one in sets if one.host == host and 0 < one.busy < gap)
    return min(fitting, key=lambda one: abs(gap / 2 - one.busy), default=None)


def _connected_sets(names: Collection[str], groups: Iterable[Collection[str]]) -> list[list[str]]:
    """The names in sets. Members of one group are in the same set."""
    set_of = {name: [name] for name in names}
    for members in groups:
        present = [name for name in members if name in set_of]
        for name in present[1:]:
            first, other = set_of[present[0]], set_of[name]
            if other is not first:
                first += other
                set_of.update(dict.fromkeys(other, first))
    return [*{id(one): one for one in set_of.values()}.values()]
