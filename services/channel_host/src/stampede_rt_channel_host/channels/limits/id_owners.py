"""Remembers which caller uses which consumer id or taker id. No other caller may consume or settle under that id."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stampede_rt.errors import PermissionDenied
from stampede_rt_runtime.access.control import owner_name

OWNED_IDS_MAX = 65_536  # ids of all callers
OWNED_IDS_OF_ONE_MAX = 1024  # ids of one caller

Key = tuple[bytes, int]  # the id of a channel or queue, and a consumer or taker id there


class IdOwners:
    """The caller of each consumer id and taker id. An id alone proves nothing, because listings of leases show the ids.

    A caller that uses more than OWNED_IDS_OF_ONE_MAX ids loses its own oldest entries. If all callers together use more
    than OWNED_IDS_MAX ids, the oldest entry of all goes.
    """

    def __init__(self) -> None:
        self._owners: OrderedDict[Key, str] = OrderedDict()  # the oldest key first; "": a service or an operator
        self._keys_of_owners: dict[str, OrderedDict[Key, None]] = {}  # the same keys by owner, the oldest key first
        self._unused: set[Key] = set()  # keys whose first use is still under way

    def __len__(self) -> int:
        return len(self._owners)

    @contextmanager
    def using(self, thing_id: bytes, used_id: int, what: str, check: Callable[[], None]) -> Iterator[None]:
        """A context in which the caller acts under `used_id` at the channel or queue `thing_id`.

        The first caller that uses an id owns the id. If the block of this first use fails, the id has no owner again.
        `check` raises PermissionDenied if the caller may not use the channel or queue at all; the caller then loses the
        id. Services of the cluster and operators may act under every id. `what` is the word for the id in the error,
        such as "consumer". Raises PermissionDenied.
        """
        key, caller = (thing_id, used_id), owner_name()
        owner = self._owners.get(key)
        try:
            check()
        except PermissionDenied:
            if owner == caller:
                self._forget(key)
            raise
        if owner is None:
            self._note(key, caller)
        elif caller and owner != caller:
            whose = owner or "a service or an operator"
            raise PermissionDenied(
                f"{what} {used_id:#x} belongs to {whose}, and {caller} may not act for it; use a number of your own"
            )
        try:
            yield
        except BaseException:
            if owner is None and key in self._unused:
                self._forget(key)
            raise
        self._unused.discard(key)

    def _note(self, key: Key, owner: str) -> None:
        self._owners[key] = owner
        self._unused.add(key)
        own = self._keys_of_owners.setdefault(owner, OrderedDict())
        own[key] = None
        if len(own) > OWNED_IDS_OF_ONE_MAX:
            self._forget(next(iter(own)))
        if len(self._owners) > OWNED_IDS_MAX:
            self._forget(next(iter(self._owners)))

    def _forget(self, key: Key) -> None:
        owner = self._owners.pop(key)
        self._unused.discard(key)
        del self._keys_of_owners[owner][key]
        if not self._keys_of_owners[owner]:
            del self._keys_of_owners[owner]
