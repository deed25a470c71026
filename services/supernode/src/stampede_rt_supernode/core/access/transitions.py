"""Changes the rules of access, and creates the key of client tokens. Pure."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.access.rules import RULES_MAX
from stampede_rt_supernode.core.access.commands import (
    AccessRuleAdded,
    AccessRuleRemoved,
    AddAccessRule,
    CreateTokenKey,
    CredentialRevoked,
    RemoveAccessRule,
    RevokeCredential,
    TokenKeyCreated,
)
from stampede_rt_supernode.core.access.effects import with_rule, without_rule
from stampede_rt_supernode.core.access.table import AccessTable
from stampede_rt_supernode.core.records import AccessChange, ChangeKind
from stampede_rt_supernode.core.state import DirectoryState

REVOKED_MAX = 1000


def create_token_key(state: DirectoryState, operation: CreateTokenKey, time_unix_nano: int) -> TokenKeyCreated:
    """Set the key, unless the directory has one, because the tokens that the present key has signed must stay valid."""
    if not state.access.token_key:
        change_access(state, replace(state.access, token_key=operation.new_token_key))
    return TokenKeyCreated(version=state.access.version)


def add_access_rule(state: DirectoryState, operation: AddAccessRule, time_unix_nano: int) -> AccessRuleAdded:
    """Add a rule. Raises InvalidArgument if there are too many."""
    rules = state.access.rules.rules
    if operation.rule in rules:
        return AccessRuleAdded(added=False, version=state.access.version)
    if len(rules) >= RULES_MAX:
        raise InvalidArgument(
            f"there are {RULES_MAX} rules of access, the most; use patterns, or remove some (stampede acl rm)"
        )
    change_access(state, replace(state.access, rules=with_rule(state.access.rules, operation.rule)))
    return AccessRuleAdded(added=True, version=state.access.version)


def remove_access_rule(state: DirectoryState, operation: RemoveAccessRule, time_unix_nano: int) -> AccessRuleRemoved:
    """Remove a rule. A missing rule is not an error."""
    rules = state.access.rules.rules
    if operation.rule not in rules:
        return AccessRuleRemoved(removed=False, version=state.access.version)
    change_access(state, replace(state.access, rules=without_rule(state.access.rules, operation.rule)))
    return AccessRuleRemoved(removed=True, version=state.access.version)


def revoke_credential(state: DirectoryState, operation: RevokeCredential, time_unix_nano: int) -> CredentialRevoked:
    """Revoke a credential. Nobody can undo this. Raises InvalidArgument if too many are revoked."""
    revoked = state.access.revoked_serials
    if operation.serial in revoked:
        return CredentialRevoked(revoked=False, version=state.access.version)
    if len(revoked) >= REVOKED_MAX:
        raise InvalidArgument(
            f"{REVOKED_MAX} certificates and tokens are revoked, the most; change to a new authority (stampede certs)"
        )
    change_access(state, replace(state.access, revoked_serials=(*revoked, operation.serial)))
    return CredentialRevoked(revoked=True, version=state.access.version)


def change_access(state: DirectoryState, access: AccessTable) -> None:
    """Set `state.access` with the present log position as its version, and note the change for watchers."""
    version = state.applied_index
    state.access = replace(access, version=version)
    state.tables.changes.note(ChangeKind.UPDATED, AccessChange(version=version))
