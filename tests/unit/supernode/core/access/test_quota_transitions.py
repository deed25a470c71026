"""Quotas in the directory."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.quotas.limits import SETTINGS_MAX, Quota, QuotaSetting
from stampede_rt_supernode.codecs.snapshot_codec import decode_snapshot, encode_snapshot
from stampede_rt_supernode.core.access.queries import access_state
from stampede_rt_supernode.core.access.quota_commands import QuotasRemoved, QuotasSet, RemoveQuotas, SetQuotas
from stampede_rt_supernode.core.command_table import check_operation
from stampede_rt_supernode.core.commands import RefusedOperation
from tests.support.supernode.operations import Log

STREAMS = QuotaSetting("cam-*", Quota.STREAMS, 5)
WAITING = QuotaSetting("cam-*", Quota.WAITING_CALLS, 7)
OTHERS = QuotaSetting("*", Quota.STREAMS, 9)


def settings(log: Log) -> tuple[QuotaSetting, ...]:
    return access_state(log.directory).quotas.settings


def test_a_setting_replaces_an_earlier_one_for_the_same_callers_and_each_change_raises_the_version() -> None:
    log = Log()
    log.apply(SetQuotas(settings=(STREAMS, OTHERS)))
    lower = QuotaSetting("cam-*", Quota.STREAMS, 1)
    assert log.apply(SetQuotas(settings=(lower,))) == QuotasSet(changed=True, version=log.directory.applied_index)
    assert set(settings(log)) == {lower, OTHERS}
    version = access_state(log.directory).version
    assert log.apply(SetQuotas(settings=(lower, OTHERS))) == QuotasSet(changed=False, version=version)


def test_the_settings_of_some_callers_are_removed_by_quota_or_all_together() -> None:
    log = Log()
    log.apply(SetQuotas(settings=(STREAMS, WAITING, OTHERS)))
    removed = log.apply(RemoveQuotas(who="cam-*", quotas=(Quota.WAITING_CALLS,)))
    assert removed == QuotasRemoved(removed=1, version=log.directory.applied_index)
    assert settings(log) == (STREAMS, OTHERS)
    log.apply(RemoveQuotas(who="cam-*"))
    version = access_state(log.directory).version
    assert log.apply(RemoveQuotas(who="cam-1")) == QuotasRemoved(removed=0, version=version)
    assert settings(log) == (OTHERS,)


def test_a_snapshot_holds_the_settings() -> None:
    log = Log()
    log.apply(SetQuotas(settings=(STREAMS, WAITING, OTHERS)))
    restored = decode_snapshot(encode_snapshot(log.directory))
    assert restored.access.quotas == log.directory.access.quotas
    assert encode_snapshot(restored) == encode_snapshot(log.directory)


def test_the_number_of_quota_settings_has_a_limit() -> None:
    log = Log()
    for at in range(0, SETTINGS_MAX, 100):
        log.apply(SetQuotas(settings=tuple(QuotaSetting(str(at + n), Quota.STREAMS, 1) for n in range(100))))
    refused = log.apply(SetQuotas(settings=(STREAMS,)))
    assert isinstance(refused, RefusedOperation)
    assert isinstance(refused.error(), InvalidArgument)
    assert isinstance(log.apply(SetQuotas(settings=(QuotaSetting("7", Quota.STREAMS, 2),))), QuotasSet)
    assert len(settings(log)) == SETTINGS_MAX


@pytest.mark.parametrize(
    "operation",
    [
        SetQuotas(settings=()),
        SetQuotas(settings=(STREAMS,) * 101),
        SetQuotas(settings=(STREAMS, QuotaSetting("cam-*", Quota.STREAMS, 6))),
        SetQuotas(settings=(QuotaSetting("a b", Quota.STREAMS, 6),)),
        RemoveQuotas(who=""),
    ],
)
def test_an_operation_with_an_invalid_value_is_refused(operation: SetQuotas | RemoveQuotas) -> None:
    with pytest.raises(InvalidArgument):
        check_operation(operation)
