"""Commands about the rules of access, and their results. Pure, immutable values; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_runtime.access.rules import AccessRule
from stampede_rt_supernode.core.commands import Operation, Success


@dataclass(frozen=True, kw_only=True, slots=True)
class CreateTokenKey(Operation):
    """Create the key of client tokens, unless there is one."""

    new_token_key: bytes = field(repr=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class AddAccessRule(Operation):
    """Add a rule, unless it is there."""

    rule: AccessRule


@dataclass(frozen=True, kw_only=True, slots=True)
class RemoveAccessRule(Operation):
    """Remove a rule, if it is there."""

    rule: AccessRule


@dataclass(frozen=True, kw_only=True, slots=True)
class RevokeCredential(Operation):
    """Revoke a certificate or token for good."""

    serial: str


@dataclass(frozen=True, kw_only=True, slots=True)
class CredentialRevoked(Success):
    """The credential is revoked. `revoked`: whether this command revoked it. `version`: as in TokenKeyCreated."""

    revoked: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class TokenKeyCreated(Success):
    """Client tokens have a key. `version`: the log position of the last change of access."""

    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessRuleAdded(Success):
    """The rule is there. `added`: whether this command added it. `version`: as in TokenKeyCreated."""

    added: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessRuleRemoved(Success):
    """The rule is not there. `removed`: whether this command removed it. `version`: as in TokenKeyCreated."""

    removed: bool
    version: int
