"""Commands about the rules of access, and their results. Pure, immutable values; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_runtime.access.rules import AccessRule
from stampede_rt_supernode.core.commands import Operation, Success


@dataclass(frozen=True, kw_only=True, slots=True)
class CreateTokenKey(Operation):
    """Client tokens get a key, unless they have one."""

    new_token_key: bytes = field(repr=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class AddAccessRule(Operation):
    """A rule is added, unless it is there."""

    rule: AccessRule


@dataclass(frozen=True, kw_only=True, slots=True)
class RemoveAccessRule(Operation):
    """A rule goes, if it is there."""

    rule: AccessRule


@dataclass(frozen=True, kw_only=True, slots=True)
class RevokeCredential(Operation):
    """A certificate or token is good no more, for good."""

    serial: str


@dataclass(frozen=True, kw_only=True, slots=True)
class CredentialRevoked(Success):
    """The credential is good no more; whether it was this command that revoked it."""

    revoked: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class TokenKeyCreated(Success):
    """Client tokens have a key. `version`: the log position of the last change of access."""

    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessRuleAdded(Success):
    """The rule is there; whether it was this command that added it."""

    added: bool
    version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class AccessRuleRemoved(Success):
    """The rule is not there; whether it was this command that removed it."""

    removed: bool
    version: int
