"""Quotas in the messages of the contract."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import quota_pb2 as pb
from stampede_rt_runtime.quotas.accounts import QuotaUse
from stampede_rt_runtime.quotas.limits import LIMIT_MAX, Quota, QuotaSetting
from stampede_rt_runtime.quotas.messages import (
    KINDS,
    known_settings,
    quota_from,
    setting_from,
    setting_message,
    use_messages,
)


@pytest.mark.parametrize("quota", Quota)
def test_each_quota_has_a_number_and_its_setting_is_the_same_after_encoding_and_decoding(quota: Quota) -> None:
    setting = QuotaSetting("cam-*", quota, LIMIT_MAX)
    assert setting_from(pb.QuotaSetting.FromString(setting_message(setting).SerializeToString())) == setting


def test_each_quota_number_of_the_contract_has_a_quota() -> None:
    assert set(KINDS.values()) == set(pb.QuotaKind.values()) - {0}


@pytest.mark.parametrize("number", [0, 99])
def test_an_unknown_quota_is_refused_in_a_request_and_ignored_in_a_response_of_a_newer_supernode(
    number: int,
) -> None:
    with pytest.raises(InvalidArgument):
        quota_from(number)
    known = pb.QuotaSetting(who="*", kind=pb.QUOTA_KIND_STREAMS, limit=3)
    newer = pb.QuotaSetting.FromString(known.SerializeToString() + b"\x10" + bytes([number]))
    assert list(known_settings([newer, known])) == [QuotaSetting("*", Quota.STREAMS, 3)]


def test_refused_callers_are_listed_first_and_then_the_callers_nearest_to_their_limit() -> None:
    def use(subject: str, used: int, limit: int, refused: int = 0) -> QuotaUse:
        return QuotaUse(subject=subject, quota=Quota.STREAMS, used=used, limit=limit, refused=refused)

    uses = [use("low", 10, 1000), use("high", 9, 10), use("refused", 0, 0, refused=1), use("least", 0, 10)]
    assert [one.subject for one in use_messages(uses, 3)] == ["refused", "high", "low"]
