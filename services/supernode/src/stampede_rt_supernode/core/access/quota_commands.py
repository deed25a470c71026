"""Commands about quotas, and their results. Pure, immutable values; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_runtime.quotas.limits import Quota, QuotaSetting
from stampede_rt_supernode.core.commands import Operation, Success


@dataclass(frozen=True, kw_only=True, slots=True)
class SetQuotas(Operation):
    """Set quotas. Each setting replaces the one of the same `who` and quota."""

    settings: tuple[QuotaSetting, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class RemoveQuotas(Operation):
    """Remove the settings of `who`, taken literally, for these quotas. `quotas` empty: for all."""

    who: str
    quotas: tuple[Quota, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class QuotasSet(Success):
    """The settings hold. Tells whether any of them was new."""

    changed: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class QuotasRemoved(Success):
    """The settings are gone. Tells how many there were."""

    removed: int
    version: int
