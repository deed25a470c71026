"""The load that a host reports with its renewals."""

from __future__ import annotations

from stampede_rt_channel_host.cluster.load_meter import LoadMeter


def test_the_load_is_the_share_of_a_core_since_the_last_report_and_the_memory() -> None:
    cpu, steady, held = [5_000], [1_000_000], [0]
    meter = LoadMeter(lambda: held[0], 4096, cpu_nanos=lambda: cpu[0], steady_nanos=lambda: steady[0])
    cpu[0], steady[0], held[0] = 255_000, 2_000_000, 100
    load = meter.measure()
    assert (load.busy_permille, load.held_bytes, load.bytes_max) == (250, 100, 4096)
    steady[0] = 3_000_000
    assert meter.measure().busy_permille == 0
    cpu[0], steady[0] = cpu[0] + 3_000_000, 4_000_000
    assert meter.measure().busy_permille == 3000, "a process may use several cores"


def test_two_reports_in_the_same_nanosecond_raise_no_error() -> None:
    meter = LoadMeter(lambda: 0, 1, cpu_nanos=lambda: 0, steady_nanos=lambda: 0)
    assert meter.measure().busy_permille == 0
