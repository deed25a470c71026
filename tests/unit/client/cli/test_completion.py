"""The completion scripts and the man page, tested in real shells if these are installed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from stampede_rt.cli.commands import run
from stampede_rt.cli.completion import SCRIPTS, SHELLS
from stampede_rt.cli.verbs import SERVICE_VERBS, VERBS

MAN_PAGE = Path(__file__).parents[4] / "client/man/stampede.1"
COMPLETE_IN_BASH = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
completion=$(complete -p stampede); completion=${completion##*-F }
${completion%% *} stampede "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


def output_of(*command: str | Path) -> str:
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout


def needs(program: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"{program} is not installed")


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_is_printed(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert script == (SCRIPTS / f"stampede.{shell}").read_text()
    assert "Copy this to" not in script, "only the help says where to put the script"


@needs("bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["wa"], {"watch"}),
        (["queue", "p"], {"put", "pending"}),
        (["get", "--newest"], {"--newest-first"}),
        (["supernode", "st"], {"status"}),
        (["echo", "--output", "js"], {"json", "jsonl"}),
    ],
)
def test_bash_completes_verbs_options_and_choices(words: list[str], expected: set[str]) -> None:
    output = output_of("bash", "-c", COMPLETE_IN_BASH, "bash", SCRIPTS / "stampede.bash", "stampede", *words)
    assert set(output.split()) == expected


@needs("zsh")
def test_zsh_reads_the_script() -> None:
    output_of("zsh", "-n", SCRIPTS / "stampede.zsh")


@needs("fish")
def test_fish_completes_verbs() -> None:
    output = output_of("fish", "--no-config", "-c", f"source {SCRIPTS}/stampede.fish; complete -C 'stampede '")
    assert {line.split("\t")[0] for line in output.splitlines()} >= {*VERBS, *SERVICE_VERBS}


@needs("groff")
def test_the_man_page_is_well_formed_and_names_every_verb() -> None:
    done = subprocess.run(
        ["groff", "-man", "-Tutf8", "-rLL=120n", "-P-cbou", MAN_PAGE],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stderr == ""
    for verb in (*VERBS, *SERVICE_VERBS):
        assert f"stampede {verb}" in done.stdout
    for title in ("EXIT STATUS", "ENVIRONMENT"):
        assert title in done.stdout
