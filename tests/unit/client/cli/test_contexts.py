"""Saved contexts: who may read them, which one counts, and that no secret is printed."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from stampede_rt.cli.commands import run
from stampede_rt.cli.contexts import Contexts, context_applied
from stampede_rt.errors import InvalidArgument, PermissionDenied

SECRET = "a-very-secret-text"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    for variable in ("STAMPEDE_URL", "STAMPEDE_CONTEXT", "STAMPEDE_SECRET_FILE"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path / "stampede"


def environment(folder: Path, **variables: str) -> dict[str, str]:
    return {"XDG_CONFIG_HOME": str(folder.parent)} | variables


def applied(folder: Path, *, has_url: bool = False, **variables: str) -> dict[str, str]:
    """The variables of the environment while a context is applied."""
    environ = environment(folder, **variables)
    with context_applied(environ, has_url=has_url):
        during = dict(environ)
    assert environ == environment(folder, **variables)
    during.pop("XDG_CONFIG_HOME")
    return during


def test_the_first_context_is_chosen_and_use_chooses_another(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["context", "add", "lab", "--url", "lab:7580"]) == 0
    assert run(["context", "add", "field", "--url", "field:1,field:2"]) == 0
    assert applied(folder) == {"STAMPEDE_URL": "lab:7580"}
    assert run(["context", "use", "field"]) == 0
    assert applied(folder) == {"STAMPEDE_URL": "field:1,field:2"}
    capsys.readouterr()
    assert run(["context", "ls", "-o", "json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["context"], row["current"]) for row in rows] == [("field", True), ("lab", False)]
    assert run(["context", "rm", "field"]) == 0
    assert applied(folder) == {}


def test_an_address_of_its_own_uses_no_context_and_the_variable_chooses_for_one_command(folder: Path) -> None:
    run(["context", "add", "lab", "--url", "lab:7580"])
    run(["context", "add", "field", "--url", "field:7580"])
    assert applied(folder, has_url=True) == {}
    assert applied(folder, STAMPEDE_URL="other:1") == {"STAMPEDE_URL": "other:1"}
    both = applied(folder, STAMPEDE_URL="other:1", STAMPEDE_CONTEXT="field")
    assert both == {"STAMPEDE_URL": "field:7580", "STAMPEDE_CONTEXT": "field"}
    with pytest.raises(InvalidArgument, match="no context 'none'; the saved ones: field, lab"):
        applied(folder, STAMPEDE_CONTEXT="none")


def test_a_kept_secret_is_for_its_owner_alone_and_is_never_printed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    source = tmp_path / "in"
    source.write_text(SECRET + "\n")
    with source.open() as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert run(["context", "add", "lab", "--url", "lab", "--secret-file", "-"]) == 0
    for form in ("table", "json", "jsonl"):
        assert run(["context", "ls", "-o", form]) == 0
    out, err = capsys.readouterr()
    assert SECRET not in out + err
    kept = Path(applied(folder)["STAMPEDE_SECRET_FILE"])
    assert kept.read_text().strip() == SECRET
    for path in (kept, folder / "contexts.json"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert SECRET not in (folder / "contexts.json").read_text()
    assert run(["context", "rm", "lab"]) == 0
    assert not kept.exists()


def test_a_file_of_contexts_that_others_may_read_is_refused(folder: Path) -> None:
    run(["context", "add", "lab", "--url", "lab"])
    os.chmod(folder / "contexts.json", 0o644)
    with pytest.raises(PermissionDenied, match="run: chmod 600"):
        Contexts.load(environment(folder))


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"current": "x", "contexts": {}}', '{"current": null, "contexts": {"../x": {"url": "a"}}}',
     '{"current": null, "contexts": {"x": {"url": 5}}}', '{"current": null, "contexts": {"x": {"path": "a"}}}',
     "[" * 9999],
)  # fmt: skip
def test_a_damaged_file_of_contexts_is_refused(folder: Path, text: str) -> None:
    folder.mkdir()
    (folder / "contexts.json").write_text(text)
    os.chmod(folder / "contexts.json", 0o600)
    with pytest.raises(InvalidArgument, match="damaged"):
        Contexts.load(environment(folder))


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["add", "../x", "--url", "a"], "is not allowed"),
        (["add", "x", "--url", "a:b"], "port"),
        (["add", "x", "--url", "a", "--secret-file", "/nowhere/at/all"], "there is no file"),
        (["use", "x"], "there is no context 'x'"),
        (["rm", "x"], "there is no context 'x'"),
    ],
)
def test_wrong_use_changes_nothing(
    folder: Path, words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["context", *words]) == 2
    assert complaint in capsys.readouterr().err
    assert not folder.exists()
