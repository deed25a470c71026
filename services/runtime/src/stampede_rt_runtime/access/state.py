"""The facts by which a port judges callers. They come from the directory. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_runtime.access.rules import NO_RULES, AccessRules
from stampede_rt_runtime.quotas.limits import NO_SETTINGS, QuotaTable


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessState:
    """The state as of `version`, the log position of its last change; 0: nothing was ever set.

    `token_keys`: the public keys for the signatures of this cluster's tokens.
    """

    version: int = 0
    cluster_id: str = ""
    rules: AccessRules = field(default=NO_RULES)
    token_keys: tuple[bytes, ...] = ()
    revoked_serials: frozenset[str] = frozenset()
    quotas: QuotaTable = field(default=NO_SETTINGS)
