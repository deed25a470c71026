"""Who consumes and takes under which number: nobody else who is judged may consume or settle in its name."""

from __future__ import annotations

from collections import OrderedDict

from stampede_rt.errors import PermissionDenied
from stampede_rt_runtime.access.control import owner_name

HOLDERS_MAX = 65_536
HOLDERS_OF_ONE_MAX = 1024

Key = tuple[bytes, int]  # a channel or queue, and a number there


class Holders:
    """The callers of consumer and taker ids. The numbers are random, and listings of leases tell them.

    A caller that uses ever more numbers makes its own be forgotten first.
    """

    def __init__(self) -> None:
        self._owners: OrderedDict[Key, str] = OrderedDict()  # in the order of their first use
        self._of_owner: dict[str, OrderedDict[Key, None]] = {}

    def __len__(self) -> int:
        return len(self._owners)

    def check(self, thing_id: bytes, holder_id: int, what: str) -> None:
        """Whether the caller may act under `holder_id` at a channel or queue; the first one of a number is its owner.

        `what`: as in "consumer". Raises PermissionDenied.
        """
        key, caller = (thing_id, holder_id), owner_name()
        owner = self._owners.get(key)
        if owner is None:
            self._note(key, caller)
        elif caller and owner != caller:
            whose = owner or "a member or an operator"
            raise PermissionDenied(
                f"{what} {holder_id:#x} is one of {whose}, and {caller} may not act for it; use a number of your own"
            )

    def _note(self, key: Key, owner: str) -> None:
        self._owners[key] = owner
        own = self._of_owner.setdefault(owner, OrderedDict())
        own[key] = None
        if len(own) > HOLDERS_OF_ONE_MAX:
            self._forget(next(iter(own)))
        if len(self._owners) > HOLDERS_MAX:
            self._forget(next(iter(self._owners)))

    def _forget(self, key: Key) -> None:
        owner = self._owners.pop(key)
        del self._of_owner[owner][key]
        if not self._of_owner[owner]:
            del self._of_owner[owner]
