"""The consumer ids and taker ids of each caller. No other caller may consume or settle under these ids."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from stampede_rt.errors import PermissionDenied
from stampede_rt_runtime.access.control import owner_name

IDS_OF_ALL_CALLERS_MAX = 65_536
IDS_OF_ONE_CALLER_MAX = 1024

Key = tuple[bytes, int]  # the id of a channel or queue, and a consumer or taker id there


class CallerIds:
    """The caller of each consumer id and taker id. An id alone proves nothing, because listings of leases show the ids.

    If a caller uses more than IDS_OF_ONE_CALLER_MAX ids, its oldest id becomes free. If all callers together use more
    than IDS_OF_ALL_CALLERS_MAX ids, the oldest id of all becomes free.
    """

    def __init__(self) -> None:
        self._callers: OrderedDict[Key, str] = OrderedDict()  # the oldest key first; "": a service or an operator
        self._keys_by_caller: dict[str, OrderedDict[Key, None]] = {}  # the same keys by caller, the oldest key first
        self._unused: set[Key] = set()  # keys whose first use is still under way

    def __len__(self) -> int:
        return len(self._callers)

    @contextmanager
    def using(self, thing_id: bytes, used_id: int, what: str, check: Callable[[], None]) -> Iterator[None]:
        """A context in which the caller acts under `used_id` at the channel or queue `thing_id`.

        The id belongs to the first caller that uses it, unless the block of this first use fails.
        `check` raises PermissionDenied if the caller may not use the channel or queue at all; the caller then loses the
        id. Services of the cluster and operators may act under every id. `what` is the word for the id in the error,
        such as "consumer". Raises PermissionDenied.
        """
        key, caller_name = (thing_id, used_id), owner_name()
        first_caller = self._callers.get(key)
        try:
            check()
        except PermissionDenied:
            if first_caller == caller_name:
                self._forget(key)
            raise
        if first_caller is None:
            self._note(key, caller_name)
        elif caller_name and first_caller != caller_name:
            whose = first_caller or "a service or an operator"
            raise PermissionDenied(
                f"{what} {used_id:#x} belongs to {whose}, and {caller_name} may not act for it; "
                "use a number of your own"
            )
        try:
            yield
        except BaseException:
            if first_caller is None and key in self._unused:
                self._forget(key)
            raise
        self._unused.discard(key)

    def _note(self, key: Key, caller_name: str) -> None:
        self._callers[key] = caller_name
        self._unused.add(key)
        keys_of_caller = self._keys_by_caller.setdefault(caller_name, OrderedDict())
        keys_of_caller[key] = None
        if len(keys_of_caller) > IDS_OF_ONE_CALLER_MAX:
            self._forget(next(iter(keys_of_caller)))
        if len(self._callers) > IDS_OF_ALL_CALLERS_MAX:
            self._forget(next(iter(self._callers)))

    def _forget(self, key: Key) -> None:
        caller_name = self._callers.pop(key)
        self._unused.discard(key)
        del self._keys_by_caller[caller_name][key]
        if not self._keys_by_caller[caller_name]:
            del self._keys_by_caller[caller_name]
