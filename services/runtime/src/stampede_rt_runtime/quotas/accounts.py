"""The use that each caller makes of one port, and its limits. Pure."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from stampede_rt.errors import Overloaded
from stampede_rt_runtime.quotas.limits import DEFAULTS, LIMIT_MAX, NO_SETTINGS, Quota, QuotaTable

IDLE_KEPT_MAX = 1024

_TEXTS: Mapping[Quota, tuple[str, str]] = {
    Quota.STREAMS: ("streams open at this port", "close some"),
    Quota.SUBSCRIPTIONS: ("subscriptions open at this port", "end some"),
    Quota.WAITING_CALLS: ("calls under way at this port", "wait for some of them"),
    Quota.BYTES_IN_FLIGHT: ("bytes in flight at this port", "put and read less at once"),
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
    """The use of one caller. `calls`: the number of its calls under way."""

    __slots__ = ("_limits", "_refused", "_used", "calls", "subject")

    def __init__(self, subject: str, limits: Mapping[Quota, int]) -> None:
        self.subject = subject
        self.calls = 0
        self._limits = limits
        self._used = dict.fromkeys(Quota, 0)
        self._refused = dict.fromkeys(Quota, 0)

    def tell(self, limits: Mapping[Quota, int]) -> None:
        """Set the limits. Present use stays, even beyond them."""
        self._limits = limits

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

    def hold(self, quota: Quota) -> Hold:
        """A part of the use of one quota, at first 0."""
        return Hold(self._used, quota)

    @contextmanager
    def using(self, quota: Quota, amount: int = 1) -> Iterator[None]:
        """Use `amount` of the quota for the duration of the block. Raises Overloaded."""
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

    @property
    def is_idle(self) -> bool:
        """Whether the caller uses nothing."""
        return not self.calls and not any(self._used.values())

    def uses(self) -> Iterator[QuotaUse]:
        """The use of each quota."""
        for quota, used in self._used.items():
            yield QuotaUse(
                subject=self.subject,
                quota=quota,
                used=used,
                limit=self._limits[quota],
                refused=self._refused[quota],
            )

    def exceeded(self, quota: Quota, more: int) -> Overloaded:
        """Count a refusal, and return its error."""
        self._refused[quota] += 1
        used, limit = self._used[quota], self._limits[quota]
        what, way_out = _TEXTS[quota]
        wanted = f" and wants {more} more" if more > 1 else ""
        return Overloaded(
            f"{self.subject} has {used} {what}{wanted}; its quota {quota} is {limit}; {way_out}, or have an operator "
            f"raise it (stampede quota set {self.subject} {quota}=LIMIT)",
            metadata={"quota": str(quota), "subject": self.subject, "used": str(used), "limit": str(limit)},
        )


class Hold:
    """A part of a caller's use of one quota. `set` never refuses. Call `Account.check` before it."""

    __slots__ = ("_amount", "_quota", "_used")

    def __init__(self, used: dict[Quota, int], quota: Quota) -> None:
        self._used = used
        self._quota = quota
        self._amount = 0

    def set(self, amount: int) -> None:
        """Set the amount in use."""
        if amount != self._amount:
            self._used[self._quota] += amount - self._amount
            self._amount = amount


WITHOUT_LIMIT: Mapping[Quota, int] = dict.fromkeys(Quota, LIMIT_MAX)


def unlimited() -> Account:
    """An account for callers without quotas."""
    return Account("", WITHOUT_LIMIT)


class Accounts:
    """The accounts of one port. Keeps all accounts in use, and the last IDLE_KEPT_MAX others."""

    def __init__(self, defaults: Mapping[Quota, int] = DEFAULTS) -> None:
        self._defaults = dict(defaults)
        self._table = NO_SETTINGS
        self._accounts: dict[str, Account] = {}
        self._idle: OrderedDict[str, None] = OrderedDict()
        self._unlimited = unlimited()

    def __len__(self) -> int:
        return len(self._accounts)

    def set_default(self, quota: Quota, limit: int) -> None:
        """Set the limit of callers without a setting. It depends on this process's own settings."""
        self._defaults[quota] = limit
        self.tell(self._table)

    def tell(self, table: QuotaTable) -> None:
        """Set the operator's settings."""
        self._table = table
        for account in self._accounts.values():
            account.tell(table.limits_of(account.subject, self._defaults))

    def of(self, subject: str | None) -> Account:
        """The account of a caller. `subjects.subject_of` gives its subject."""
        if subject is None:
            return self._unlimited
        account = self._accounts.get(subject)
        if account is None:
            account = self._accounts[subject] = Account(subject, self._table.limits_of(subject, self._defaults))
            self._rest(account)
        return account

    def enter(self, account: Account) -> None:
        """Note that a call of the caller begins."""
        account.calls += 1
        self._idle.pop(account.subject, None)

    def leave(self, account: Account) -> None:
        """Note that a call of the caller has ended."""
        account.calls -= 1
        if not account.calls and account is not self._unlimited:
            self._rest(account)

    def uses(self) -> list[QuotaUse]:
        """The use of all callers that use quotas or were refused."""
        return [use for one in self._accounts.values() for use in one.uses() if use.used or use.refused]

    def _rest(self, account: Account) -> None:
        """Let the account be forgotten later, if it is idle then."""
        self._idle[account.subject] = None
        for _ in range(2):
            if len(self._idle) <= IDLE_KEPT_MAX:
                return
            subject, _ = self._idle.popitem(last=False)
            if self._accounts[subject].is_idle:
                del self._accounts[subject]
            else:
                self._idle[subject] = None
