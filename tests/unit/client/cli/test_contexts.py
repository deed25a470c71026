"""Saved contexts: who may read them, which context a command uses, and no secret in any output."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from stampede_rt.cli.commands import run
from stampede_rt.cli.contexts import Contexts, context_applied
from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.security.credentials import secret_file

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


def test_a_command_with_an_address_uses_no_context_and_the_variable_names_the_context_of_one_command(
    folder: Path,
) -> None:
    run(["context", "add", "lab", "--url", "lab:7580"])
    run(["context", "add", "field", "--url", "field:7580"])
    assert applied(folder, has_url=True) == {}
    assert applied(folder, STAMPEDE_URL="other:1") == {"STAMPEDE_URL": "other:1"}
    both = applied(folder, STAMPEDE_URL="other:1", STAMPEDE_CONTEXT="field")
    assert both == {"STAMPEDE_URL": "field:7580", "STAMPEDE_CONTEXT": "field"}
    with pytest.raises(InvalidArgument, match="no context 'none'; the saved ones: field, lab"):
        applied(folder, STAMPEDE_CONTEXT="none")


def test_only_its_owner_can_read_a_kept_secret_and_it_is_never_printed(
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


def contexts_of(text: str) -> bytes:
    return b'{"current": null, "contexts": ' + text.encode() + b"}"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"", "no JSON object"), (b"[]", "no JSON object"), (b"\xff", "no JSON object"),
        (b"[" * 9999, "no JSON object"),
        (b'{"current": null, "contexts": {}} ' + b" " * 2**20, "no JSON object of at most"),
        (b"{}", 'needs "current" and "contexts"'), (contexts_of("[]"), '"contexts" is an object'),
        (contexts_of('{"../x": {"url": "a"}}'), "context '../x' has a name that is not allowed"),
        (contexts_of('{"x": {}}'), "context 'x' has no \"url\""), (contexts_of('{"x": 5}'), "has no \"url\""),
        (contexts_of('{"x": {"url": ""}}'), "has no \"url\""), (contexts_of('{"x": {"url": 5}}'), "no text in 'url'"),
        (contexts_of('{"x": {"url": "a\\u001b[2J"}}'), "no text in 'url'"),
        (contexts_of('{"x": {"url": "a\\u0000"}}'), "no text in 'url'"),
        (contexts_of('{"x": {"url": "a", "tls_ca": null}}'), "no text in 'tls_ca'"),
        (contexts_of('{"x": {"url": "a", "path": "b"}}'), "unknown field 'path'; allowed are url, secret_file"),
        (b'{"current": "y", "contexts": {}}', "\"current\" is 'y', which is not a context"),
        (b'{"current": [], "contexts": {}}', '"current" is \\[\\]'),
    ],
)  # fmt: skip
@pytest.mark.parametrize("words", [["context", "use", "x"], ["context", "ls"], ["ls"]])
def test_a_damaged_file_of_contexts_is_refused_with_the_reason(
    folder: Path, text: bytes, why: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    write_contexts(folder, text)
    with pytest.raises(InvalidArgument, match=why):
        Contexts.load(environment(folder))
    assert run(words) == 2
    error_output = capsys.readouterr().err
    assert error_output.startswith("stampede: the contexts in ")
    assert error_output.endswith("correct the file, or delete it\n")


def write_contexts(folder: Path, text: bytes) -> None:
    folder.mkdir()
    (folder / "contexts.json").write_bytes(text)
    os.chmod(folder / "contexts.json", 0o600)


def test_the_error_names_a_folder_in_place_of_the_file_of_contexts(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "contexts.json").mkdir(parents=True)
    assert run(["context", "ls"]) == 1
    assert "contexts.json cannot be read: Is a directory" in capsys.readouterr().err


def test_a_user_without_a_home_folder_has_no_contexts_and_no_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", no_home)
    monkeypatch.delenv("XDG_CONFIG_HOME")
    assert Contexts.load({}).folder == Path("/.config/stampede")
    assert secret_file() == Path("/.config/stampede/secret")


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
def test_a_verb_with_wrong_arguments_changes_no_context(
    folder: Path, words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["context", *words]) == 2
    assert complaint in capsys.readouterr().err
    assert not folder.exists()
