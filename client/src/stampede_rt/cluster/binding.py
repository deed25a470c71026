"""The caches of a client, and the order of its supernodes (paper, sections 4.2 and 4.3). Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

CACHE_ENTRIES_MAX = 100_000  # the most owners, and the most bindings


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """The address at which a client reaches the data of a channel or queue, with the epoch and incarnation there.

    `subject_id`: the id of the channel or queue.
    """

    subject_id: bytes
    target: str
    epoch: int
    incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Owner:
    """The host that owns a channel or queue, with the epoch of the channel or queue there.

    `incarnation` is the incarnation of a queue. For a channel it is 0, and the channel's binding has the incarnation.
    """

    host_id: bytes
    epoch: int
    spec_version: int
    incarnation: int = 0


@dataclass(slots=True)
class BindingCache:
    """The gatekeepers of hosts, the owners of channels and queues, and the bindings of channels.

    The cache keeps one binding for each channel and thread. The client forgets a stale entry. The cache is bounded: a
    full cache drops its entries and starts again.
    """

    _gatekeepers: dict[bytes, Sequence[str]] = field(default_factory=dict)
    _owners: dict[bytes, Owner] = field(default_factory=dict)
    _bindings: dict[bytes, dict[int, Binding]] = field(default_factory=dict)

    def binding(self, subject_id: bytes, thread_id: int) -> Binding | None:
        """Return the binding of a channel for a thread; None if the cache has none."""
        by_thread = self._bindings.get(subject_id)
        return by_thread.get(thread_id) if by_thread else None

    def owner(self, subject_id: bytes) -> Owner | None:
        """Return the owner of a channel or queue; None if the cache has none."""
        return self._owners.get(subject_id)

    def reachable_owner(self, subject_id: bytes) -> Owner | None:
        """Return the owner. If the cache lacks the gatekeepers of this host, drop the owner and return None."""
        owner = self._owners.get(subject_id)
        if owner is None or owner.host_id in self._gatekeepers:
            return owner
        self._owners.pop(subject_id, None)
        return None

    def gatekeepers(self, host_id: bytes) -> Sequence[str]:
        """Return the addresses of a host's gatekeeper, best first; an empty sequence if the cache has none."""
        return self._gatekeepers.get(host_id, ())

    def learn_owner(self, subject_id: bytes, owner: Owner, gatekeepers: Sequence[str]) -> None:
        """Keep a supernode's answer: the owner of a channel or queue, and the gatekeepers of that host."""
        if len(self._owners) >= CACHE_ENTRIES_MAX:
            self._owners.clear()
            self._gatekeepers.clear()
        self._owners[subject_id] = owner
        self._gatekeepers[owner.host_id] = tuple(gatekeepers)

    def learn_binding(self, binding: Binding, thread_id: int) -> None:
        """Keep the binding that a gatekeeper gave to a thread."""
        if len(self._bindings) >= CACHE_ENTRIES_MAX:
            self._bindings.clear()
        self._bindings.setdefault(binding.subject_id, {})[thread_id] = binding

    def forget(self, subject_id: bytes) -> None:
        """Drop the bindings and the owner of a channel or queue, and the gatekeepers of this owner."""
        self._bindings.pop(subject_id, None)
        owner = self._owners.pop(subject_id, None)
        if owner is not None:
            self._gatekeepers.pop(owner.host_id, None)

    def follow(self, subject_id: bytes, moved: Mapping[str, str]) -> None:
        """Learn the new owner of a channel from the metadata of MOVED. Does nothing if they name none."""
        if "target" in moved and "epoch" in moved:
            owner = Owner(
                host_id=bytes.fromhex(moved["host_id"]),
                epoch=int(moved["epoch"]),
                spec_version=int(moved["spec_version"]),
            )
            self.learn_owner(subject_id, owner, (moved["target"],))

    def forget_all(self) -> None:
        """Drop everything."""
        self._gatekeepers.clear()
        self._owners.clear()
        self._bindings.clear()


def order_by_round_trip(
    targets: Iterable[str], round_trip_s: dict[str, float], in_other_zones: Collection[str] = ()
) -> list[str]:
    """Return the supernodes at `targets`, best first (paper, section 4.3).

    Supernodes of the caller's zone come before the supernodes `in_other_zones`, and a shorter round trip comes before a
    longer one. Supernodes without a round trip did not answer, and come last. Equal supernodes keep their order.
    """

    def order(target: str) -> tuple[bool, bool, float]:
        return (target not in round_trip_s, target in in_other_zones, round_trip_s.get(target, 0.0))

    return sorted(targets, key=order)
