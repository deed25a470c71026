"""The help of the command line: it explains every argument, and no verb takes an argument that it ignores."""

import argparse
import subprocess
import sys
from collections.abc import Iterator

import pytest

from stampede_rt.cli.commands import full_parser, parser_of, run
from stampede_rt.cli.main import ON_THE_MAIN_THREAD
from stampede_rt.cli.verbs import SERVICE_VERBS, VERBS

# An empty interpreter has about 35 modules.
HELP_MODULES_MAX = 110
VERB_MODULES_MAX = 160
SERVICE_MODULES_MAX = 220


def verbs(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parser, and the parsers of its verbs."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from verbs(verb)


def test_every_argument_of_every_verb_has_a_help_text() -> None:
    parsers = list(verbs(full_parser()))
    assert len(parsers) > 30
    for parser in parsers:
        for action in parser._actions:
            assert action.help or isinstance(action, argparse._SubParsersAction), (parser.prog, action.dest)


def test_a_channel_has_no_message_ids_so_its_put_takes_none(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["put", "cam", "x", "--message-id", "one"])
    assert ended.value.code == 2
    assert "stampede put has no argument --message-id;" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "unknown"),
    [
        (["group", "get", "rig", "--last", "30s"], "--last"),
        (["get", "cam", "--first=1s", "--last", "1s"], "--first"),
    ],
)
def test_an_unknown_option_is_named_before_the_value_after_it(
    words: list[str], unknown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run(words)
    assert ended.value.code == 2
    assert f"has no argument {unknown}; see stampede" in capsys.readouterr().err


@pytest.mark.parametrize("ttl", ["0s", "-1h", "31d", "soon"])
def test_the_error_for_an_impossible_ttl_names_the_argument(ttl: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["token", "issue", "cam", f"--ttl={ttl}"])
    assert ended.value.code == 2
    logged = capsys.readouterr().err
    assert "--ttl" in logged
    assert "nanos" not in logged


@pytest.mark.parametrize(
    ("word", "hint"), [("lst", "did you mean ls? "), ("supernod", "did you mean supernode? "), ("xyzzy", "")]
)
def test_the_error_for_an_unknown_verb_names_a_similar_one(
    word: str, hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([word, "-o", "json"]) == 2
    assert capsys.readouterr().err == f"stampede: there is no verb {word}; {hint}`stampede --help` lists the verbs\n"


def listed(parser: argparse.ArgumentParser) -> dict[str, str | None]:
    """The verbs of a parser and their help texts, in the order of its help."""
    [action] = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    return {choice.dest: choice.help for choice in action._choices_actions}


def test_the_short_list_of_verbs_is_the_list_of_all_parsers() -> None:
    assert listed(full_parser()) == listed(parser_of()) == {name: text for name, (_, text) in VERBS.items()}


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_is_parsed_without_the_modules_of_other_verbs(verb: str) -> None:
    module = VERBS[verb][0]
    assert set(listed(parser_of(verb))) == {name for name, (other, _) in VERBS.items() if other == module}


def modules_of(*words: str) -> int:
    """The number of modules that a new interpreter has loaded at the end of this command."""
    code = "import sys\nfrom stampede_rt.cli.main import main\ntry: main(sys.argv[1:])\nexcept SystemExit: pass\n"
    code += "sys.stderr.write(str(len(sys.modules)))"
    done = subprocess.run([sys.executable, "-I", "-c", code, *words], capture_output=True, timeout=60, check=True)
    return int(done.stderr)


def test_help_loads_few_modules_so_that_it_is_fast() -> None:
    assert modules_of("--help") < HELP_MODULES_MAX
    assert modules_of("get", "--help") < VERB_MODULES_MAX


@pytest.mark.parametrize("verb", ["dev", "frontend", "supernode", "host", "web"])
def test_the_help_of_a_service_loads_its_settings_and_no_other_module_of_it(verb: str) -> None:
    assert modules_of(verb, "--help") < SERVICE_MODULES_MAX


def test_every_verb_of_another_package_runs_on_the_main_thread_where_it_may_handle_signals() -> None:
    assert set(SERVICE_VERBS) <= set(ON_THE_MAIN_THREAD)
