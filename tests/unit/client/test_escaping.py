"""No verb prints control characters from its arguments. A script may take an argument from another program's output."""

from __future__ import annotations

import pytest

from stampede_rt.cli.main import main as stampede
from stampede_rt.escaping import escaped

HOSTILE = "a\x1b]0;title\x07b\r\nforged\u202e\x9b31m"
VERBS = (
    ["certs", HOSTILE],
    ["certs", "show", HOSTILE],
    ["certs", "issue", "--dir", HOSTILE, "--name", "x", "--role", "client"],
    ["certs", "issue", "--name", "x", "--role", HOSTILE],
    ["certs", "revoke", HOSTILE],
    ["supernode", HOSTILE],
    ["supernode", "--listen", HOSTILE],
    ["supernode", "init", "--listen", "localhost:1", "--data-dir", "folder", "--restore", HOSTILE],
    ["supernode", "status", "--member", HOSTILE],
    ["supernode", "remove", "s1", "--member", HOSTILE],
    ["supernode", "status", HOSTILE],
    ["host", "--listen", HOSTILE],
    ["frontend", "--supernodes", HOSTILE],
    ["dev", "--listen", HOSTILE],
    ["demo", HOSTILE],
    ["bench", HOSTILE],
    ["acl", "check", "who", HOSTILE, "name"],
)


@pytest.mark.parametrize("words", VERBS, ids=lambda words: "-".join(words).replace(HOSTILE, "HOSTILE"))
def test_no_verb_prints_control_characters_of_its_arguments(
    words: list[str], capsys: pytest.CaptureFixture[str], tmp_path: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(str(tmp_path))
    try:
        status = stampede(words)
    except SystemExit as end:
        status = int(end.code or 0)
    output = "".join(capsys.readouterr())
    assert status != 0
    assert "forged" in output, "the error names the argument"
    assert output == "\n".join(map(escaped, output.split("\n")))
    assert not any(line.startswith("forged") for line in output.split("\n"))
