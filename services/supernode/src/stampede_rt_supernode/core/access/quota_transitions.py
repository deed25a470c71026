"""Changes the quotas. Pure."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.quotas.limits import SETTINGS_MAX, QuotaTable, check_setting, check_who
from stampede_rt_supernode.core.access.quota_commands import QuotasRemoved, QuotasSet, RemoveQuotas, SetQuotas
from stampede_rt_supernode.core.access.transitions import change_access
from stampede_rt_supernode.core.state import DirectoryState

SETTINGS_PER_REQUEST_MAX = 100


def check_set_quotas(operation: SetQuotas) -> None:
    """Check the operation without the state. Raises InvalidArgument."""
    if not 1 <= len(operation.settings) <= SETTINGS_PER_REQUEST_MAX:
        raise InvalidArgument(
            f"the request has {len(operation.settings)} settings of quotas; give 1 to {SETTINGS_PER_REQUEST_MAX}"
        )
    for setting in operation.settings:
        check_setting(setting)
    if len({(one.who, one.quota) for one in operation.settings}) < len(operation.settings):
        raise InvalidArgument("the request sets the same quota of the same callers twice; leave one of the two out")


def check_remove_quotas(operation: RemoveQuotas) -> None:
    """Check the operation without the state. Raises InvalidArgument."""
    check_who(operation.who)


def set_quotas(state: DirectoryState, operation: SetQuotas, time_unix_nano: int) -> QuotasSet:
    """Set quotas. Raises InvalidArgument if there are too many settings."""
    before = {(one.who, one.quota): one for one in state.access.quotas.settings}
    after = before | {(one.who, one.quota): one for one in operation.settings}
    if after == before:
        return QuotasSet(changed=False, version=state.access.version)
    if len(after) > SETTINGS_MAX:
        raise InvalidArgument(
            f"there would be {len(after)} settings of quotas, and {SETTINGS_MAX} is the most; remove some, or write "
            "patterns"
        )
    change_access(state, replace(state.access, quotas=QuotaTable(after.values())))
    return QuotasSet(changed=True, version=state.access.version)


def remove_quotas(state: DirectoryState, operation: RemoveQuotas, time_unix_nano: int) -> QuotasRemoved:
    """Remove settings of quotas. A missing setting is not an error."""
    settings = state.access.quotas.settings
    staying = [
        one for one in settings if one.who != operation.who or (operation.quotas and one.quota not in operation.quotas)
    ]
    removed = len(settings) - len(staying)
    if removed:
        change_access(state, replace(state.access, quotas=QuotaTable(staying)))
    return QuotasRemoved(removed=removed, version=state.access.version)
