"""The rules of access, quotas, revocations and token key of the directory. Pure, immutable values."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_runtime.access.rules import NO_RULES, AccessRules
from stampede_rt_runtime.quotas.limits import NO_SETTINGS, QuotaTable


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessTable:
    """The directory's facts about access. `version`: the log position of the last change; 0 if there was none.

    `token_key` signs client tokens. No caller ever gets it. It is empty until a leader begins a tenure at feature level
    2 or above, or a caller creates it by CreateTokenKey.
    """

    version: int = 0
    rules: AccessRules = field(default=NO_RULES)
    token_key: bytes = field(default=b"", repr=False)
    revoked_serials: tuple[str, ...] = ()
    quotas: QuotaTable = field(default=NO_SETTINGS)
