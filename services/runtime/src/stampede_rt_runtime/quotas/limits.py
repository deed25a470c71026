"""The quotas of callers: the kinds, the defaults, and the settings of an operator. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.globs import matcher

SETTINGS_MAX = 1000
PATTERN_CHARACTERS_MAX = 256
LIMIT_MAX = 2**62
_WHO = re.compile(r"@?[A-Za-z0-9._/:*?-]+", re.ASCII)


class Quota(StrEnum):
    """One kind of quota. Each host and each supernode counts separately."""

    STREAMS = "streams"
    SUBSCRIPTIONS = "subscriptions"
    WAITING_CALLS = "waiting-calls"
    BYTES_IN_FLIGHT = "bytes-in-flight"
    CHANNELS = "channels"
    QUEUES = "queues"
    CHANGES_PER_SECOND = "changes-per-second"
    BYTES_HELD = "bytes-held"
    CPU_PERCENT = "cpu-percent"
    GROUPS = "groups"
    PEERS = "peers"
    BYTES_ARCHIVED = "bytes-archived"


DEFAULTS: Mapping[Quota, int] = {
    Quota.STREAMS: 3072,  # a port allows 4096
    Quota.SUBSCRIPTIONS: 2048,
    Quota.WAITING_CALLS: 16_384,
    Quota.BYTES_IN_FLIGHT: 512 * 2**20,
    Quota.CHANNELS: 150_000,  # a directory has room for 200,000
    Quota.QUEUES: 150_000,
    Quota.CHANGES_PER_SECOND: 1000,
    Quota.BYTES_HELD: LIMIT_MAX,  # a host sets its own limit
    Quota.CPU_PERCENT: 50,
    Quota.GROUPS: 7500,  # a directory has room for 10,000
    # A directory has room for 100,000. A mailbox takes the room of a queue, and 40,000 mailboxes and 150,000 queues
    # leave room for other callers.
    Quota.PEERS: 40_000,
    Quota.BYTES_ARCHIVED: LIMIT_MAX,  # a host with an archive sets its own limit
}
# The directory counts these things, and refuses a further one.
IN_DIRECTORY = frozenset({Quota.CHANNELS, Quota.QUEUES, Quota.GROUPS, Quota.PEERS})
COUNTED_BY_CREATOR = IN_DIRECTORY | {Quota.BYTES_HELD, Quota.BYTES_ARCHIVED}
"""These quotas count the things that a caller has created, wherever it calls from.

Callers without a name of their own count together, by the kind of their credential.
"""
# The names of callers whose credential has no name of its own. COUNTED_BY_CREATOR have no default limit for them.
SHARED_NAMES = frozenset({"@clients", "@cluster", "@anyone"})


@dataclass(frozen=True, slots=True)
class QuotaSetting:
    """The limit of one quota, for callers that match the pattern `who`."""

    who: str
    quota: Quota
    limit: int

    def __str__(self) -> str:
        return f"{self.who} {self.quota}={self.limit}"


def check_who(who: str) -> None:
    """Raises InvalidArgument for a pattern that matches no caller."""
    if not 0 < len(who) <= PATTERN_CHARACTERS_MAX or _WHO.fullmatch(who) is None:
        raise InvalidArgument(
            f"who of a quota is {who[:64]!r}; write the name of a client, or @ADDRESS for callers without a name, such "
            "as @10.0.0.7, with '*' for any run of characters and '?' for one"
        )


def check_setting(setting: QuotaSetting) -> None:
    """Raises InvalidArgument for an impossible pattern or limit."""
    check_who(setting.who)
    if not 0 <= setting.limit <= LIMIT_MAX:
        raise InvalidArgument(f"{setting.quota} is {setting.limit}; give a limit from 0 to {LIMIT_MAX}")


def check_effective(setting: QuotaSetting) -> None:
    """Raises InvalidArgument for a limit that would have no effect."""
    if setting.quota is Quota.CPU_PERCENT and 100 < setting.limit < LIMIT_MAX:
        raise InvalidArgument(
            f"{setting.quota} is {setting.limit}; a service has 100 % of its event loop: give 0 to 100, or `unlimited`"
        )


class QuotaTable:
    """All settings of a cluster.

    If several settings of a quota match a caller, the setting for exactly this name counts. Otherwise the pattern with
    the most literal characters counts. If several patterns have equally many, the lowest limit counts.
    """

    def __init__(self, settings: Iterable[QuotaSetting] = ()) -> None:
        self.settings = tuple(settings)
        self._by_weight = sorted(self.settings, key=_weight, reverse=True)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, QuotaTable) and other.settings == self.settings

    def __hash__(self) -> int:
        return hash(self.settings)

    def setting_for(self, subject: str, quota: Quota) -> QuotaSetting | None:
        """The setting that counts for a caller; None: the default counts."""
        found = (one for one in self._by_weight if one.quota is quota and matcher(one.who)(subject))
        return next(found, None)

    def limits_of(self, subject: str, defaults: Mapping[Quota, int] = DEFAULTS) -> dict[Quota, int]:
        """The limits of a caller."""
        limits = dict(defaults)
        if subject in SHARED_NAMES:
            limits.update(dict.fromkeys(COUNTED_BY_CREATOR, LIMIT_MAX))
        for one in reversed(self._by_weight):  # reversed, so that the setting that counts comes last
            if matcher(one.who)(subject):
                limits[one.quota] = one.limit
        return limits


def _weight(setting: QuotaSetting) -> tuple[bool, int, int]:
    wildcards = setting.who.count("*") + setting.who.count("?")
    return wildcards == 0, len(setting.who) - wildcards, -setting.limit


NO_SETTINGS = QuotaTable()
