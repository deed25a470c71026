"""The directory's facts about access. Pure, immutable values."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_runtime.access.rules import NO_RULES, AccessRules
from stampede_rt_runtime.quotas.limits import NO_SETTINGS, QuotaTable


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessTable:
    """The state as of `version`, the log position of its last change; 0 if it has never changed.

    `token_key` signs client tokens. No caller ever gets it. It is empty as long as there were no tokens.
    """

    version: int = 0
    rules: AccessRules = field(default=NO_RULES)
    token_key: bytes = field(default=b"", repr=False)
    revoked_serials: tuple[str, ...] = ()
    quotas: QuotaTable = field(default=NO_SETTINGS)
