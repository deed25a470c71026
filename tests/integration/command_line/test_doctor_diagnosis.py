"""The findings of `stampede doctor` about parts whose answers are made up here."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from stampede_rt.cli.diagnosis import diagnose
from stampede_rt.cli.observations import FRONTEND, HOST, PEER, SUPERNODE, CheckResult, Inventory, Observation

DAY_S = 86400.0
MS = 1_000_000


def seen(kind: str, name: str, **facts: Any) -> Observation:
    facts = {"round_trip_nanos": MS, "clock_offset_nanos": 0, "version": "1.0", **facts}
    return Observation(kind=kind, name=name, address=f"{name}:1", **facts)


HEALTHY = [
    seen(FRONTEND, "f1"),
    seen(SUPERNODE, "s1"),
    seen(SUPERNODE, "s2"),
    seen(SUPERNODE, "s3"),
    seen(HOST, "h1"),
]


def found(observations: list[Observation], part: str) -> CheckResult:
    findings = diagnose(observations, own_version="1.0", certificate_s_min=14 * DAY_S)
    [one] = [finding for finding in findings if finding.part == part]
    return one


def changed(name: str, **facts: Any) -> list[Observation]:
    return [replace(one, **facts) if one.name == name else one for one in HEALTHY]


def test_a_healthy_cluster_gets_no_advice() -> None:
    findings = diagnose(HEALTHY, own_version="1.0", certificate_s_min=14 * DAY_S)
    assert [finding for finding in findings if finding.advice] == []


def test_a_service_that_refuses_the_caller_is_not_reported_as_down() -> None:
    refusing = [replace(one, failure="another secret", refuses_caller=True) for one in HEALTHY]
    assert found(refusing, "supernode s1").state == "refused"
    for part in ("quorum", "front-ends"):
        finding = found(refusing, part)
        assert (finding.state, "use the cluster's secret and certificates" in finding.advice) == ("unknown", True)


def test_a_removed_supernode_does_not_count_for_the_majority() -> None:
    gone = seen(SUPERNODE, "s0", failure="nobody is there", is_member=False)
    also_gone = replace(gone, name="s4")
    assert found([*HEALTHY, gone, also_gone], "quorum") == CheckResult("quorum", "-", "3 of 3 serve")
    assert found([*HEALTHY, gone], "supernode s0").state == "no member"


def test_the_advice_about_a_supernode_that_does_not_answer_is_to_start_or_replace_it() -> None:
    quorum = found(changed("s2", failure="nobody is there"), "quorum")
    assert quorum.state == "2 of 3 serve"
    assert quorum.advice.startswith("start s2 again with its data folder. If the folder is lost, replace the supernode")


@pytest.mark.parametrize(("nanos", "how"), [(1500 * MS, "1.5 s ahead of"), (-60 * MS, "60 ms behind")])
def test_the_report_of_a_wrong_clock_names_its_owner_its_offset_and_the_allowed_offset(nanos: int, how: str) -> None:
    clocks = found(changed("h1", clock_offset_nanos=nanos), "clocks")
    assert clocks.advice == f"the clock of host h1 is {how} the others'; synchronise it (chrony, ntpd)"
    assert "s +/- 1 ms apart; 50 ms are allowed" in clocks.state


def test_doctor_reports_the_clock_of_this_machine_if_all_others_differ_from_it_equally() -> None:
    clocks = found([replace(one, clock_offset_nanos=-2000 * MS) for one in HEALTHY], "clocks")
    assert (
        clocks.advice == "this machine's clock is 2 s ahead of the cluster's; synchronise this machine's (chrony, ntpd)"
    )


def test_a_long_round_trip_widens_the_tolerance_for_a_clock() -> None:
    assert not found(changed("h1", clock_offset_nanos=90 * MS, round_trip_nanos=50 * MS), "clocks").advice
    assert found(changed("h1", clock_offset_nanos=90 * MS, round_trip_nanos=30 * MS), "clocks").advice


def test_an_answer_that_took_two_seconds_is_too_slow_for_a_clock_offset() -> None:
    slow = changed("f1", clock_offset_nanos=1000 * MS, round_trip_nanos=2000 * MS)
    assert found(slow, "clocks") == CheckResult("clocks", "-", "0 s +/- 1 ms apart; 50 ms are allowed")
    alone = [one for one in slow if one.name == "f1"]
    clocks = found(alone, "clocks")
    assert (clocks.state, clocks.advice) == ("unknown: answers took 2 s or longer, too long to compare clocks", "")


def test_a_clock_that_is_off_by_more_than_a_slow_answer_can_explain_is_reported() -> None:
    slow = changed("f1", clock_offset_nanos=3000 * MS, round_trip_nanos=2000 * MS)
    assert found(slow, "clocks").advice.startswith("the clock of front-end f1 is 3 s ahead of the others'")


def test_a_peer_whose_clock_is_off_is_reported_as_a_host_would_be() -> None:
    clocks = found([*HEALTHY, seen(PEER, "robot/3", clock_offset_nanos=-1500 * MS)], "clocks")
    assert clocks.advice == "the clock of peer robot/3 is 1.5 s behind the others'; synchronise it (chrony, ntpd)"
    assert clocks.state == "1.5 s +/- 1 ms apart; 50 ms are allowed"


def test_clocks_of_peers_do_not_decide_which_clocks_are_right() -> None:
    peers = [seen(PEER, f"phone/{number}", clock_offset_nanos=200 * MS) for number in range(20)]
    advice = found([*HEALTHY, *peers], "clocks").advice
    assert (advice.count("the clock of peer phone/"), "host" in advice, "this machine" in advice) == (20, False, False)


def test_only_a_peer_with_imprecise_measurements_gets_more_tolerance() -> None:
    vague = seen(PEER, "far", clock_offset_nanos=300 * MS, round_trip_nanos=800 * MS)
    off = replace(HEALTHY[-1], clock_offset_nanos=300 * MS)
    assert found([*HEALTHY[:-1], off, vague], "clocks").advice.startswith(
        "the clock of host h1 is 300 ms ahead of the others'"
    )
    assert "far" not in found([*HEALTHY[:-1], off, vague], "clocks").advice


def test_a_peer_without_a_measured_clock_is_not_judged() -> None:
    peer = seen(PEER, "older", clock_offset_nanos=None, round_trip_nanos=None, version="0.7 of something else")
    findings = diagnose([*HEALTHY, peer], own_version="1.0", certificate_s_min=14 * DAY_S)
    assert [finding for finding in findings if finding.advice] == []
    assert found([*HEALTHY, peer], "clocks").state.startswith("0 s +/- 1 ms apart")
    assert found([*HEALTHY, peer], "peer older").state == "ok"


def test_two_versions_are_reported_with_the_parts_that_run_them() -> None:
    versions = found(changed("s2", version="0.9"), "versions")
    assert versions.state == "0.9, 1.0"
    assert "0.9: supernode s2; 1.0: this caller, front-end f1, supernode s1" in versions.advice
    assert "runbook: upgrade" in versions.advice


@pytest.mark.parametrize(
    ("left_s", "advice"),
    [(13.5 * DAY_S, "its certificate ends in 13.5 days; issue it"), (-5.0, "its certificate has expired; issue it")],
)
def test_a_certificate_that_ends_soon_or_has_ended_is_reported(left_s: float, advice: str) -> None:
    assert found(changed("h1", certificate_left_s=left_s), "host h1").advice.startswith(advice)


def test_a_short_lived_certificate_is_reported_when_a_third_of_its_life_is_left() -> None:
    short = {"certificate_lasts_s": DAY_S}
    assert found(changed("h1", certificate_left_s=DAY_S / 2, **short), "host h1").advice == ""
    advice = found(changed("h1", certificate_left_s=DAY_S / 4, **short), "host h1").advice
    assert advice.startswith("its certificate ends in 6.0 hours; issue it anew")


@pytest.mark.parametrize(
    ("facts", "state"),
    [
        ({"alive": False, "lost_for_nanos": 11_000 * MS}, "lost 11 s ago"),
        ({"alive": False}, "gone"),
        ({"lease_held": False}, "fenced"),
        ({"failure": "nobody is there"}, "unreachable"),
    ],
)
def test_a_host_that_is_lost_or_fenced_or_unreachable_is_reported(facts: dict[str, Any], state: str) -> None:
    host = found(changed("h1", **facts), "host h1")
    assert (host.state, bool(host.advice)) == (state, True)


def test_recently_refused_puts_get_advice_about_memory_and_older_refusals_are_only_counted() -> None:
    facts = {"refused_items": 12, "held_bytes": 2**30, "memory_bytes_max": 2**30}
    host = found(changed("h1", refused_ago_nanos=3000 * MS, **facts), "host h1")
    assert host.state == "12 puts refused"
    assert "the last one 3 s ago; it holds 1.0 GiB of 1.0 GiB: raise --memory-bytes-max" in host.advice
    host = found(changed("h1", refused_ago_nanos=3600_000 * MS, **facts), "host h1")
    assert (host.state, host.advice) == ("ok, 12 puts refused before", "")


def test_puts_that_the_limit_of_the_archive_refused_get_advice_about_the_archive() -> None:
    host = found(changed("h1", refused_items=12, refused_ago_nanos=3000 * MS, refused_for_archive=True), "host h1")
    assert "its archive has no room (--archive-bytes-max, or max_archive of st.host)" in host.advice
    assert "--memory-bytes-max" not in host.advice


def test_calls_that_a_host_refused_are_reported_beside_the_puts() -> None:
    host = found(changed("h1", refused_calls=3, refused_call_ago_nanos=5000 * MS), "host h1")
    assert host.state == "3 calls refused"
    assert "it refused or ended calls as Overloaded, the last one 5 s ago" in host.advice
    host = found(changed("h1", refused_calls=3, refused_call_ago_nanos=3600_000 * MS), "host h1")
    assert (host.state, host.advice) == ("ok, 3 calls refused before", "")
    facts = {"refused_calls": 3, "refused_call_ago_nanos": 5000 * MS, "refused_items": 1}
    host = found(changed("h1", refused_ago_nanos=5000 * MS, **facts), "host h1")
    assert host.state == "1 put and 3 calls refused"
    assert "--memory-bytes-max" in host.advice
    assert "a reader that took nothing" in host.advice


def test_denials_are_counted_and_get_no_advice() -> None:
    finding = found(changed("h1", denials=3, denied_ago_nanos=5000 * MS), "access")
    assert (finding.state, finding.advice) == ("3 calls denied, the last one 5 s ago, at host h1 (3)", "")
    finding = found(changed("h1", denials=1, denied_ago_nanos=5000 * MS), "access")
    assert finding.state == "1 call denied, the last one 5 s ago, at host h1 (1)"


def test_doctor_counts_calls_beyond_quotas_and_names_callers_with_recent_refusals() -> None:
    finding = found(changed("h1", quota_refusals=3, quota_refused_ago_nanos=5000 * MS), "quotas")
    assert finding.state == "3 calls refused, the last one 5 s ago, at host h1 (3)"
    assert "`stampede quota use`" in finding.advice
    assert found(changed("h1", quota_refusals=3, quota_refused_ago_nanos=3600_000 * MS), "quotas").advice == ""


def test_lost_channels_and_queues_are_reported_by_name_and_host() -> None:
    lost = [(f"cam/{number}", "host h7") for number in range(7)]
    held = [Inventory(kind="channel", count=9, lost=lost), Inventory(kind="queue", count=4)]
    findings = diagnose(HEALTHY, held, own_version="1.0", certificate_s_min=14 * DAY_S)
    [channels, queues] = [finding for finding in findings if finding.part in ("channels", "queues")]
    assert (channels.state, queues) == ("7 of 9 lost", CheckResult("queues", "-", "4, none lost"))
    assert channels.advice.startswith(
        "the items of cam/0, cam/1, cam/2, cam/3, cam/4 and 2 more were lost with host h7"
    )


def test_recorded_channels_of_absent_hosts_are_not_reported_as_lost() -> None:
    held = [Inventory(kind="channel", count=3, lost=[("live", "host h7")], recorded=[("rec", "host h8")])]
    findings = diagnose(HEALTHY, held, own_version="1.0", certificate_s_min=0)
    [channels] = [one for one in findings if one.part == "channels"]
    assert channels.state == "1 of 3 lost, 1 of 3 recorded at an absent host"
    assert "the items of live were lost with host h7" in channels.advice
    assert "start host h8 again with the same archive, which has the recorded items of rec." in channels.advice
    gone = found(changed("h1", alive=False), "host h1")
    assert (gone.state, "open them again" in gone.advice) == ("gone", False)


def test_a_running_majority_without_a_leader_is_not_reported_as_missing_supernodes() -> None:
    observations = [replace(one, ready=False) if one.kind == SUPERNODE else one for one in HEALTHY]
    quorum = found(observations, "quorum")
    assert quorum.state == "3 of 3 run, 0 serve"
    assert "has no leader; look again in 5 s, then check the network" in quorum.advice
    down = [replace(one, failure="nobody is there") if one.name == "s1" else one for one in observations]
    assert "has no leader; look again in 5 s, then start s1 again with its data folder" in found(down, "quorum").advice


def test_doctor_reports_supernodes_without_data_folders_and_gives_no_advice() -> None:
    quorum = found([replace(one, in_memory=one.kind == SUPERNODE) for one in HEALTHY], "quorum")
    assert (quorum.state, quorum.advice) == ("3 of 3 serve, only in memory", "")


def test_the_advice_after_the_loss_of_all_supernodes_names_the_chapter_of_the_runbook() -> None:
    observations = [replace(one, failure="nobody is there") if one.kind == SUPERNODE else one for one in HEALTHY]
    assert (
        "start s1, s2 and s3 with their data folders. If the folders are lost" in found(observations, "quorum").advice
    )
    assert "see the runbook: lose all" in found(observations, "quorum").advice


def test_doctor_advises_to_start_a_host_if_there_is_none() -> None:
    assert "stampede host" in found(HEALTHY[:-1], "host").advice


@pytest.mark.parametrize(
    ("levels", "state", "advice"),
    [
        ({"s1": (1, 1), "s2": (1, 1), "s3": (1, 1)}, "1", ""),
        (
            {"s1": (1, 2), "s2": (1, 1), "s3": (1, 2)},
            "1, and not all supernodes know 2",
            "upgrade s2; the level then rises by itself",
        ),
        (
            {"s1": (1, 2), "s2": (0, 0), "s3": (1, 1)},
            "1, and not all supernodes know 2",
            "upgrade s3 and start s2, whose",
        ),
        ({"s1": (1, 2), "s2": (1, 2), "s3": (1, 2)}, "1, about to rise to 2", ""),
        (
            {"s1": (2, 2), "s2": (1, 2), "s3": (2, 3)},
            "2, and not all supernodes know 3",
            "upgrade s1 and s2; the level then rises",
        ),
    ],
)
def test_the_report_names_the_feature_level_and_the_supernodes_that_hold_it_down(
    levels: dict[str, tuple[int, int]], state: str, advice: str
) -> None:
    findings = [
        seen(SUPERNODE, name, feature_level=level, highest_feature_level=highest)
        for name, (level, highest) in levels.items()
    ]
    finding = found(findings, "feature level")
    assert finding.state == state
    assert finding.advice.startswith(advice)
    assert bool(finding.advice) == bool(advice)
