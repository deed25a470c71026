"""`stampede bench growth` on a small scale: it measures and reports everything. No time is judged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stampede_rt_bench.app import main
from stampede_rt_bench.growth.dimensions import DIMENSIONS
from stampede_rt_bench.growth.own_channels import powers
from stampede_rt_bench.growth.report import steepest
from stampede_rt_bench.measuring import Spread
from tests.support.command_line.documented_fields import require_fields

SMALL = ["--channels-max", "3", "--items-max", "200", "--readers-max", "3", "--groups-max", "2"]
SMALL += ["--runs", "2", "--operations", "8"]


def test_growth_of_everything_is_measured_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["growth", *SMALL, "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    report = json.loads((tmp_path / "growth.json").read_text())
    assert set(report["growth"]) == set(DIMENSIONS)
    sizes = {name: [cost["size"] for cost in found["costs"]] for name, found in report["growth"].items()}
    assert (sizes["channels"], sizes["items"]) == ([1, 3], [100, 200])
    assert (sizes["readers"], sizes["groups"]) == ([1, 3], [1, 2])
    page = (tmp_path / "growth.md").read_text()
    for name, dimension in DIMENSIONS.items():
        operations = [operation for operation in report["growth"][name]["costs"][0] if operation != "size"]
        assert any("put" in operation for operation in operations)
        assert any("get" in operation for operation in operations)
        for cost in report["growth"][name]["costs"]:
            assert all(0 < cost[operation]["least"] <= cost[operation]["median"] for operation in operations)
        assert dimension.title in printed
        assert f"### {dimension.title}\n\n| {dimension.what} |" in page
        assert (tmp_path / f"growth-{name}.png").read_bytes().startswith(b"\x89PNG")


def test_only_the_named_growth_is_measured_and_printed_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["growth", "--of", "readers", *SMALL, "--out", str(tmp_path), "-o", "jsonl"]) == 0
    output = capsys.readouterr()
    require_fields("bench growth", output.out)
    assert output.out.count("\n") == 1
    assert DIMENSIONS["readers"].title in output.err
    assert list(json.loads((tmp_path / "growth.json").read_text())["growth"]) == ["readers"]


def test_a_constant_cost_has_the_exponent_0_and_a_proportional_one_1() -> None:
    def costs(*values: float) -> dict[int, dict[str, Spread]]:
        return {10**place: {"put": Spread.of([value])} for place, value in enumerate(values)}

    assert steepest(costs(5, 5, 5), "put") == 0
    assert steepest(costs(1, 1, 10), "put") == pytest.approx(1)
    assert steepest(costs(1, 100, 100), "put") == pytest.approx(2)
    assert steepest(costs(7), "put") is None


def test_sizes_are_powers_of_ten_up_to_the_largest() -> None:
    assert list(powers(1, 1000)) == [1, 10, 100, 1000]
    assert list(powers(100, 250)) == [100, 250]
    assert list(powers(100, 20)) == [20]
