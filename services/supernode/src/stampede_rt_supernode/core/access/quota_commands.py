"""Commands about quotas, and their results. Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_runtime.quotas.limits import Quota, QuotaSetting
from stampede_rt_supernode.core.commands import Operation, Success


@dataclass(frozen=True, kw_only=True, slots=True)
class SetQuotas(Operation):
    """Set quotas. Each setting replaces the setting of the same `who` and quota."""

    settings: tuple[QuotaSetting, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class RemoveQuotas(Operation):
    """Remove the settings of `who` for these quotas; for all quotas if `quotas` is empty.

    `who` is not a pattern here: it must be the text of the settings.
    """

    who: str
    quotas: tuple[Quota, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class QuotasSet(Success):
    """The settings are in effect. `changed`: whether this command changed any of them.

    `version`: as in TokenKeyCreated.
    """

    changed: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class QuotasRemoved(Success):
    """The settings are gone. `removed`: how many settings this command removed. `version`: as in TokenKeyCreated."""

    removed: int
    version: int
