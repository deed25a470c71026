"""Cross-sections: an item of a reference channel with items of other channels, without a group (paper, section 3.3)."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any, TypeVar

from stampede_rt._async.reader import Reader
from stampede_rt.errors import InvalidArgument
from stampede_rt.transports.concurrency_async import monotonic_s, run_all
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import ByChannel, CrossSection, Over
from stampede_rt.values.model import Item
from stampede_rt.values.reading import Wait
from stampede_rt.values.timeline import NOW, BoundLike, Bounds, InstantLike

Key = TypeVar("Key", bound=Reader)


async def cross_section(
    reference: Key,
    others: Sequence[Key],
    at: BoundLike,
    *,
    over: Over,
    complete: bool,
    payloads: bool,
    timeout: float | None,
    as_of: InstantLike | None = None,
    clock_s: Callable[[], float] = monotonic_s,
) -> CrossSection[Key]:
    """See `Connection.cross_section`. `clock_s`: the clock of the timeout."""
    if over not in ("start", "span"):
        raise InvalidArgument(f'over is {over!r}; write "start" or "span" (of the reference\'s item)')
    if isinstance(others, str | Reader):
        raise InvalidArgument(f"others is {others!r}; give a list of channels, even for one")
    for channel in (reference, *others):
        if not isinstance(channel, Reader):
            raise InvalidArgument(
                f"{channel!r} is not a channel; give the handle from connection.channel(...), not the name"
            )
    wait, began_s = Wait.parse(timeout), clock_s()
    held = await reference.at(at, payloads=payloads, timeout=timeout, as_of=as_of)
    found = {reference.info.channel_id: held}
    if held:

        def read_beside(other: Key) -> Awaitable[Items]:
            left = wait.after(clock_s() - began_s)
            get_arguments = {"complete": complete, "payloads": payloads, "timeout": left.seconds, "as_of": as_of}
            return _read_beside(other, held[-1], over, get_arguments)

        ids = (other.info.channel_id for other in others)
        reads = [functools.partial(read_beside, other) for other in others]
        found |= dict(zip(ids, await run_all(reads), strict=True))
    return CrossSection(time=held[-1].time if held else None, items=ByChannel([reference, *others], found))


async def _read_beside(other: Reader, item: Item, over: Over, get_arguments: Mapping[str, Any]) -> Items:
    """Return the items of `other` at the time of `item` (`over` "start"), or during the span of `item` ("span").

    If the span of `item` has no end yet, return the items up to now. `get_arguments`: further arguments of `get`.
    """
    end: BoundLike = item.time
    bounds: Bounds = "[]"
    if over == "span" and item.end != item.time:
        end, bounds = (NOW, "[]") if item.end is None else (item.end, "[)")
    return await other.get(item.time, end, bounds=bounds, **get_arguments)
