"""The settings of quotas, and the setting that holds for each caller."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt_runtime.quotas.limits import (
    DEFAULTS,
    LIMIT_MAX,
    Quota,
    QuotaSetting,
    QuotaTable,
    check_effective,
    check_setting,
)


def table(*settings: tuple[str, int]) -> QuotaTable:
    return QuotaTable(QuotaSetting(who, Quota.STREAMS, limit) for who, limit in settings)


def test_a_caller_without_a_setting_has_the_default_limits() -> None:
    assert QuotaTable().limits_of("cam-1") == dict(DEFAULTS)


def test_the_matching_setting_with_the_longest_pattern_applies() -> None:
    settings = table(("*", 1), ("cam-*", 2), ("cam-1*", 3), ("cam-1", 4))
    limits = {who: settings.limits_of(who)[Quota.STREAMS] for who in ("x", "cam-2", "cam-12", "cam-1")}
    assert limits == {"x": 1, "cam-2": 2, "cam-12": 3, "cam-1": 4}
    for who, limit in limits.items():
        found = settings.setting_for(who, Quota.STREAMS)
        assert found is not None
        assert found.limit == limit


def test_a_setting_for_a_whole_name_holds_before_one_with_a_longer_pattern() -> None:
    settings = table(("cam-1", 1), ("c?m-1*", 2), ("cam-1?*", 3))
    assert settings.limits_of("cam-1")[Quota.STREAMS] == 1


def test_the_lower_limit_of_two_equally_specific_patterns_applies_in_any_order() -> None:
    for settings in (table(("cam*", 5), ("*cam", 3)), table(("*cam", 3), ("cam*", 5))):
        assert settings.limits_of("cam")[Quota.STREAMS] == 3


def test_a_setting_leaves_the_other_quotas_as_they_are() -> None:
    limits = table(("*", 1)).limits_of("cam")
    assert limits == {**DEFAULTS, Quota.STREAMS: 1}
    assert table(("*", 1)).setting_for("cam", Quota.WAITING_CALLS) is None


@pytest.mark.parametrize("who", ["cam-*", "@10.0.0.*", "@fe80:1:2:3::/64", "@clients", "*"])
def test_a_setting_may_be_for_a_name_an_address_or_a_pattern_of_either(who: str) -> None:
    check_setting(QuotaSetting(who, Quota.STREAMS, 0))


@pytest.mark.parametrize(("who", "limit"), [("", 1), ("a b", 1), ("x" * 257, 1), ("a", -1), ("a", LIMIT_MAX + 1)])
def test_impossible_subjects_and_limits_are_refused(who: str, limit: int) -> None:
    with pytest.raises(InvalidArgument):
        check_setting(QuotaSetting(who, Quota.STREAMS, limit))


def test_a_limit_above_a_whole_event_loop_is_refused_because_it_has_no_effect() -> None:
    for limit in (0, 1, 100, LIMIT_MAX):
        check_effective(QuotaSetting("cam", Quota.CPU_PERCENT, limit))
    check_effective(QuotaSetting("cam", Quota.STREAMS, 300))
    with pytest.raises(InvalidArgument, match=r"cpu-percent is 300; .* give 0 to 100, or `unlimited`"):
        check_effective(QuotaSetting("cam", Quota.CPU_PERCENT, 300))
