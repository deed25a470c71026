"""The use of one port by each caller, and the limits of each caller. Pure."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from weakref import WeakValueDictionary

from stampede_rt.errors import Overloaded
from stampede_rt_runtime.quotas.limits import DEFAULTS, IN_DIRECTORY, LIMIT_MAX, NO_SETTINGS, Quota, QuotaTable
from stampede_rt_runtime.quotas.loop_shares import LoopShare, LoopShares

RECENT_MAX = 1024
BURST_SECONDS = 10
"""A caller may make the changes of this many seconds in one burst."""

_BY_NAME = {str(quota): quota for quota in Quota}
_TEXTS: Mapping[Quota, tuple[str, str]] = {
    Quota.STREAMS: ("streams open at this port", "close some"),
    Quota.SUBSCRIPTIONS: ("subscriptions open at this port", "end some"),
    Quota.WAITING_CALLS: ("calls under way at this port", "wait for some of them"),
    Quota.BYTES_IN_FLIGHT: ("bytes in flight at this port", "put and read less at a time"),
    Quota.CHANNELS: ("channels", "delete some"),
    Quota.QUEUES: ("queues", "delete some"),
    Quota.GROUPS: ("groups", "delete some"),
    Quota.PEERS: ("peers", "let some leave"),
    Quota.CHANGES_PER_SECOND: ("changes of the directory a second", "make them more slowly"),
    Quota.BYTES_HELD: (
        "bytes held in its channels and queues here",
        "tighten retention, delete some, or use another host",
    ),
    Quota.BYTES_ARCHIVED: (
        "bytes on the disk in its recorded channels here",
        "record less, use another host, or have an operator delete the folders of its deleted channels",
    ),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class QuotaUse:
    """The use that one caller makes of one quota, and the number of refusals."""

    subject: str
    quota: Quota
    used: int
    limit: int
    refused: int


class Account:
    """The use of one caller. It lives as long as there is a reference to it."""

    __slots__ = (
        "__weakref__", "_changes", "_changes_at_s", "_clock_s", "_limits", "_on_refused", "_refused", "_used",
        "loop_share", "subject",
    )  # fmt: skip

    def __init__(
        self,
        subject: str,
        limits: Mapping[Quota, int],
        clock_s: Callable[[], float] = lambda: 0.0,
        loop_shares: LoopShares | None = None,
        on_refused: Callable[[Quota], None] = lambda quota: None,
    ) -> None:
        """`clock_s`: seconds of a clock that never goes back. `loop_shares` None: the caller's work never waits."""
        self.loop_share = None if loop_shares is None else LoopShare(loop_shares, limits[Quota.CPU_PERCENT])
        self.subject = subject
        self._clock_s = clock_s
        self._on_refused = on_refused
        self._limits = limits
        self._used = dict.fromkeys(Quota, 0)
        self._refused = dict.fromkeys(Quota, 0)
        self._changes = 0.0  # a leaky bucket: each change adds 1, each second takes off the limit
        self._changes_at_s = 0.0

    def set_limits(self, limits: Mapping[Quota, int]) -> None:
        """Set the limits. Present use stays, even beyond them."""
        self._limits = limits
        if self.loop_share is not None:
            self.loop_share.percent = limits[Quota.CPU_PERCENT]

    def has_room(self, quota: Quota, more: int = 1) -> bool:
        """Whether the caller may use `more` of the quota."""
        return self._used[quota] + more <= self._limits[quota]

    def check(self, quota: Quota, more: int = 1) -> None:
        """Raises Overloaded if the caller may not use `more` of the quota."""
        if self._used[quota] + more > self._limits[quota]:
            raise self.exceeded(quota, more)

    def take(self, quotas: Iterable[Quota]) -> None:
        """Use one of each quota until `give_back`."""
        for quota in quotas:
            self._used[quota] += 1

    def give_back(self, quotas: Iterable[Quota]) -> None:
        """Give back one of each quota."""
        for quota in quotas:
            self._used[quota] -= 1

    def charge_for(self, quota: Quota) -> QuotaCharge:
        """An object that sets a part of the caller's use of one quota. The part is 0 at first."""
        return QuotaCharge(self, quota)

    @contextmanager
    def using(self, quota: Quota, amount: int = 1) -> Iterator[None]:
        """Use `amount` of the quota for the duration of the block.

        Raises Overloaded if the amount is beyond the quota of the caller.
        """
        self.check(quota, amount)
        self._used[quota] += amount
        try:
            yield
        finally:
            self._used[quota] -= amount

    @contextmanager
    def waiting(self, kept_bytes: int) -> Iterator[None]:
        """Count a waiting call that keeps `kept_bytes`, for the duration of the block. Raises Overloaded."""
        with self.using(Quota.WAITING_CALLS), self.using(Quota.BYTES_IN_FLIGHT, kept_bytes):
            yield

    def limit(self, quota: Quota) -> int:
        """The most that the caller may use."""
        return self._limits[quota]

    def add(self, quota: Quota, amount: int) -> None:
        """Add `amount`, which may be negative, to the use."""
        self._used[quota] += amount

    def set_used(self, quota: Quota, amount: int) -> None:
        """Set the use of a quota that another place counts."""
        self._used[quota] = amount

    def change(self) -> None:
        """Count one change of the directory. Raises Overloaded if the caller makes too many changes."""
        changes = self._changes_now() + 1
        if changes > BURST_SECONDS * self._limits[Quota.CHANGES_PER_SECOND]:
            raise self.exceeded(Quota.CHANGES_PER_SECOND, 1)
        self._changes = changes

    def _changes_now(self) -> float:
        now_s = self._clock_s()
        passed = (now_s - self._changes_at_s) * self._limits[Quota.CHANGES_PER_SECOND]
        self._changes, self._changes_at_s = max(0.0, self._changes - passed), now_s
        self._used[Quota.CHANGES_PER_SECOND] = round(self._changes / BURST_SECONDS)
        return self._changes

    def uses(self) -> Iterator[QuotaUse]:
        """The use of each quota."""
        self._changes_now()
        if self.loop_share is not None:
            self._used[Quota.CPU_PERCENT] = self.loop_share.used_percent()
        for quota, used in self._used.items():
            yield QuotaUse(
                subject=self.subject,
                quota=quota,
                used=used,
                limit=self._limits[quota],
                refused=self._refused[quota],
            )

    def count_refusal(self, quota: Quota) -> None:
        """Count a refusal."""
        self._refused[quota] += 1
        self._on_refused(quota)

    def exceeded(self, quota: Quota, more: int) -> Overloaded:
        """Count a refusal, and return its error."""
        self.count_refusal(quota)
        used, limit = self._used[quota], self._limits[quota]
        what, way_out = _TEXTS[quota]
        wanted = f" and wants {more} more" if more > 1 else ""
        return Overloaded(
            f"{self.subject} has {used} {what}{wanted}; its quota {quota} is {limit}; {way_out}, or have an operator "
            f"raise the quota (stampede quota set {self.subject} {quota}=LIMIT)",
            metadata={"quota": str(quota), "subject": self.subject, "used": str(used), "limit": str(limit)},
        )


class QuotaCharge:
    """A part of a caller's use of one quota. `set` never refuses, so call `Account.check` before `set`."""

    __slots__ = ("_account", "_amount", "_quota")

    def __init__(self, account: Account, quota: Quota) -> None:
        self._account = account
        self._quota = quota
        self._amount = 0

    def set(self, amount: int) -> None:
        """Set the amount in use."""
        if amount != self._amount:
            self._account.add(self._quota, amount - self._amount)
            self._amount = amount


WITHOUT_LIMIT: Mapping[Quota, int] = dict.fromkeys(Quota, LIMIT_MAX)


_UNLIMITED = Account("", WITHOUT_LIMIT)


def unlimited() -> Account:
    """The account of all callers without quotas."""
    return _UNLIMITED


class Accounts:
    """The accounts of one port: the accounts to which some object refers, and the last RECENT_MAX accounts in use."""

    def __init__(
        self,
        defaults: Mapping[Quota, int] = DEFAULTS,
        clock_s: Callable[[], float] = lambda: 0.0,
        loop_shares: LoopShares | None = None,
    ) -> None:
        """`clock_s`, `loop_shares`: see `Account`."""
        self._loop_shares = loop_shares
        self._defaults = dict(defaults)
        self._clock_s = clock_s
        self._table = NO_SETTINGS
        self._accounts: WeakValueDictionary[str, Account] = WeakValueDictionary()
        self._recent: OrderedDict[str, Account] = OrderedDict()
        self._directory: Callable[[], Iterable[tuple[str, Quota, int]]] = tuple
        self.refusals = 0
        self.refusals_of = dict.fromkeys(Quota, 0)
        self._refused_at_s = 0.0

    def __len__(self) -> int:
        return len(self._accounts)

    def set_default(self, quota: Quota, limit: int) -> None:
        """Set the limit for callers to whom no setting of an operator applies."""
        self._defaults[quota] = limit
        self.set_table(self._table)

    def set_table(self, table: QuotaTable) -> None:
        """Set the operator's settings."""
        self._table = table
        for account in [*self._accounts.values()]:
            account.set_limits(table.limits_of(account.subject, self._defaults))

    def of(self, subject: str | None) -> Account:
        """The account of the caller with this subject, see `subjects.subject_of`. None: the account without limits."""
        if not subject:
            return unlimited()
        account = self._accounts.get(subject)
        if account is None:
            limits = self._table.limits_of(subject, self._defaults)
            account = self._accounts[subject] = Account(
                subject, limits, self._clock_s, self._loop_shares, self._note_refusal
            )
        self._recent[subject] = account
        self._recent.move_to_end(subject)
        if len(self._recent) > RECENT_MAX:
            self._recent.popitem(last=False)
        return account

    def refused_ago_nanos(self) -> int | None:
        """The time since the last refusal, in nanoseconds; None: there was none."""
        return None if not self.refusals else round((self._clock_s() - self._refused_at_s) * 1e9)

    def _note_refusal(self, quota: Quota) -> None:
        self.refusals += 1
        self.refusals_of[quota] += 1
        self._refused_at_s = self._clock_s()

    def draw_from(self, directory: Callable[[], Iterable[tuple[str, Quota, int]]]) -> None:
        """Set the function from which `uses` gets the numbers of channels, queues, groups and peers of callers.

        `directory` returns triples of caller, quota and number, for the quotas of IN_DIRECTORY.
        """
        self._directory = directory

    def count_refusal(self, error: Overloaded) -> None:
        """Count a refusal by code outside this object, such as the directory. Ignores an error that names no quota."""
        quota, subject = _BY_NAME.get(error.metadata.get("quota", "")), error.metadata.get("subject", "")
        if quota is not None and subject:
            self.of(subject).count_refusal(quota)

    def uses(self) -> list[QuotaUse]:
        """The use of all callers that use quotas or were refused."""
        for one in [*self._accounts.values()]:
            for quota in IN_DIRECTORY:
                one.set_used(quota, 0)
        in_directory = [(self.of(subject), quota, used) for subject, quota, used in self._directory()]
        for account, quota, used in in_directory:
            account.set_used(quota, used)
        return [use for one in [*self._accounts.values()] for use in one.uses() if use.used or use.refused]
