"""Commands about the rules of access, and their results. Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_runtime.access.rules import AccessRule
from stampede_rt_supernode.core.commands import Operation, Success


@dataclass(frozen=True, kw_only=True, slots=True)
class CreateTokenKey(Operation):
    """Create the key that signs client tokens, unless the directory has one."""

    new_token_key: bytes = field(repr=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class AddAccessRule(Operation):
    """Add a rule, unless the directory has the same rule."""

    rule: AccessRule


@dataclass(frozen=True, kw_only=True, slots=True)
class RemoveAccessRule(Operation):
    """Remove a rule, if the directory has it."""

    rule: AccessRule


@dataclass(frozen=True, kw_only=True, slots=True)
class RevokeCredential(Operation):
    """Revoke a certificate or token. Nobody can undo this."""

    serial: str


@dataclass(frozen=True, kw_only=True, slots=True)
class CredentialRevoked(Success):
    """The credential is revoked. `revoked`: whether this command revoked it. `version`: as in TokenKeyCreated."""

    revoked: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class TokenKeyCreated(Success):
    """The directory has a key for client tokens. `version`: the log position of the last change of the AccessTable."""

    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessRuleAdded(Success):
    """The directory has the rule. `added`: whether this command added it. `version`: as in TokenKeyCreated."""

    added: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessRuleRemoved(Success):
    """The directory does not have the rule. `removed`: whether this command removed it.

    `version`: as in TokenKeyCreated.
    """

    removed: bool
    version: int
