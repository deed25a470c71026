"""`stampede bench paper` runs to its end on a small scale and writes its charts. These tests judge no times."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stampede_rt_bench.app import main
from stampede_rt_bench.filling import filled_channel, time_of
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.paper.memory_cost import RUNS_OF_ITEMS
from stampede_rt_bench.tables import Table
from tests.support.command_line.documented_fields import require_fields

PNG = b"\x89PNG"


@pytest.mark.parametrize("figure", ["get"])
def test_a_figure_prints_its_table_and_draws_its_chart(
    figure: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["paper", "--figure", figure, "--items-max", "1000", "--runs", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    assert "1,000" in capsys.readouterr().out
    assert (tmp_path / f"{figure}.png").read_bytes().startswith(PNG)


def test_a_figure_as_json_has_the_documented_fields_and_all_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["paper", "--figure", "memory", "--items-max", "1000", "--runs", "1", "--out", str(tmp_path)]
    assert main([*words, "--output", "json"]) == 0
    output = capsys.readouterr()
    require_fields("bench paper", output.out)
    assert "stampede bench: Memory of held items" in output.err
    (figure,) = json.loads(output.out)
    assert {row["items in a run"] for row in figure["rows"]} == set(RUNS_OF_ITEMS)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "file"
    file.touch()
    assert main(["paper", "--out", str(file / "charts")]) == 1
    assert str(file / "charts") in capsys.readouterr().err


def test_a_number_out_of_range_is_refused_with_the_range(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["paper", "--items-max", "5"])
    assert "from 1000 to" in capsys.readouterr().err


def test_a_filled_channel_holds_every_item_at_its_time() -> None:
    channel = filled_channel(1000, run_items=256)
    assert channel.counters(time_of(1000)).held == 1000
    assert (channel.oldest, channel.newest) == (time_of(0), time_of(999))


def test_a_spread_is_the_median_between_the_least_and_the_most() -> None:
    assert Spread.of([3.0, 1.0, 2.0]) == Spread(2.0, 1.0, 3.0)


def test_a_table_aligns_its_columns() -> None:
    assert Table(["a", "bb"], [["100", "2"]], ["note"]).render() == "  a  bb\n100   2\nnote"
