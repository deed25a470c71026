"""The guard of the wire contract: it accepts additions, and refuses each change that would break an older client."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tools import breaking

FIRST_PROTO = """syntax = "proto3";
package thing.v1;
service ThingService {
  rpc Look(LookRequest) returns (LookResponse);
}
message LookRequest {
  int64 max_age_nanos = 1;
  string name = 2;
}
message LookResponse {}
"""


@pytest.fixture
def contract(tmp_path: Path) -> tuple[Path, Path]:
    """A small contract and its accepted image."""
    source = tmp_path / "proto" / "thing" / "v1" / "thing_service.proto"
    source.parent.mkdir(parents=True)
    source.write_text(FIRST_PROTO)
    stable = tmp_path / "stable.binpb"
    assert breaking.main(["--accept", "--proto", str(tmp_path / "proto"), "--stable", str(stable)]) == 0
    return source, stable


def guard(source: Path, stable: Path) -> int:
    return breaking.main(["--proto", str(source.parents[2]), "--stable", str(stable)])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("int64 max_age_nanos = 1", "string max_age_nanos = 1", "max_age_nanos"),
        ("int64 max_age_nanos = 1", "int64 max_age_nanos = 3", "was deleted"),
        ("string name = 2;", "", "name"),
        ("string name = 2;", "string title = 2;", "title"),
        ("  rpc Look(LookRequest) returns (LookResponse);\n", "", "Look"),
        ("(LookRequest) returns", "(stream LookRequest) returns", "client"),
    ],
)
def test_a_breaking_change_fails_and_is_named(
    contract: tuple[Path, Path], capsys: pytest.CaptureFixture[str], old: str, new: str, expected: str
) -> None:
    source, stable = contract
    assert old in FIRST_PROTO
    source.write_text(FIRST_PROTO.replace(old, new))
    assert guard(source, stable) == 1
    printed = capsys.readouterr().out
    assert expected in printed
    assert "--accept" in printed


def test_an_unchanged_contract_passes_in_silence(
    contract: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert guard(*contract) == 0
    assert capsys.readouterr().out == ""


def test_an_addition_passes_with_the_remark_that_it_is_unprotected(
    contract: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    source, stable = contract
    source.write_text(FIRST_PROTO.replace("message LookResponse {}", "message LookResponse { int64 seq = 1; }"))
    assert guard(source, stable) == 0
    assert "does not protect" in capsys.readouterr().out


def test_accepting_makes_a_breaking_change_the_contract(contract: tuple[Path, Path]) -> None:
    source, stable = contract
    source.write_text(FIRST_PROTO.replace("string name = 2;", "string title = 2;"))
    assert breaking.main(["--accept", "--proto", str(source.parents[2]), "--stable", str(stable)]) == 0
    assert guard(source, stable) == 0


def test_the_error_for_a_missing_image_names_a_remedy(
    contract: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    source, stable = contract
    stable.unlink()
    assert guard(source, stable) == 2
    assert "--accept" in capsys.readouterr().out


def test_sources_that_do_not_compile_are_not_reported_as_a_breaking_change(contract: tuple[Path, Path]) -> None:
    source, stable = contract
    source.write_text(FIRST_PROTO.replace("message LookResponse {}", ""))
    assert guard(source, stable) == 2


def test_the_contract_of_this_checkout_is_honoured() -> None:
    assert breaking.violations(breaking.PROTO, breaking.STABLE) == []


def test_a_change_planted_into_a_copy_of_our_own_contract_is_found(tmp_path: Path) -> None:
    copy = tmp_path / "proto"
    shutil.copytree(breaking.PROTO, copy)
    item = copy / "stampede_rt" / "v1" / "item.proto"
    text = item.read_text()
    assert "fixed64 first_seq = 7;" in text
    item.write_text(text.replace("fixed64 first_seq = 7;", "uint64 first_seq = 7;"))
    assert any("first_seq" in line for line in breaking.violations(copy, breaking.STABLE))


UNSERVED_PROTO = f"""syntax = "proto3";
package thing.v1;
{breaking.UNSERVED} It may change in any way.
service PlannedService {{
  rpc Plan(PlanRequest) returns (PlanResponse);
}}
message PlanRequest {{
  string name = 1;
}}
message PlanResponse {{}}
"""


def test_a_file_that_is_not_served_yet_may_change_and_is_named_each_time(
    contract: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    source, stable = contract
    planned = source.with_name("planned_service.proto")
    planned.write_text(UNSERVED_PROTO)
    assert breaking.main(["--accept", "--proto", str(source.parents[2]), "--stable", str(stable)]) == 0
    planned.write_text(UNSERVED_PROTO.replace("string name", "bytes name"))
    assert guard(source, stable) == 0
    assert "planned_service.proto" in capsys.readouterr().out
    planned.unlink()
    assert guard(source, stable) == 0


def test_adding_the_mark_does_not_remove_a_file_from_the_accepted_contract(contract: tuple[Path, Path]) -> None:
    source, stable = contract
    source.with_name("other.proto").write_text('syntax = "proto3";\npackage thing.v1;\nmessage Other {}\n')
    marked = FIRST_PROTO.replace("package thing.v1;", f"package thing.v1;\n{breaking.UNSERVED}")
    source.write_text(marked.replace("string name = 2;", ""))
    assert guard(source, stable) == 1


def test_a_file_is_accepted_when_its_mark_is_removed(contract: tuple[Path, Path]) -> None:
    source, stable = contract
    planned = source.with_name("planned_service.proto")
    served = UNSERVED_PROTO.replace(breaking.UNSERVED, "// ")
    planned.write_text(served)
    assert breaking.main(["--accept", "--proto", str(source.parents[2]), "--stable", str(stable)]) == 0
    planned.write_text(served.replace("string name", "bytes name"))
    assert guard(source, stable) == 1


def test_exactly_the_unimplemented_services_bear_the_mark() -> None:
    sources = "\n".join(path.read_text() for path in breaking.ROOT.glob("services/*/src/**/*.py"))
    marked = {
        name: path in breaking.unserved(breaking.PROTO)
        for path in breaking.PROTO.rglob("*_service.proto")
        for name in re.findall(r"^service (\w+)", path.read_text(), re.MULTILINE)
    }
    is_served = {name: f"{name}Servicer" in sources or f'"stampede_rt.v1.{name}"' in sources for name in marked}
    assert {name for name in marked if marked[name]} == {name for name in marked if not is_served[name]}
    assert len(marked) > 10
