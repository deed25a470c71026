"""The help of the command line: it explains every argument, and no verb takes an argument that it ignores."""

import argparse
from collections.abc import Iterator

import pytest

from stampede_rt.cli.commands import _parser, run


def verbs(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parser and those of its verbs."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from verbs(verb)


def test_every_argument_of_every_verb_has_a_help_text() -> None:
    parsers = list(verbs(_parser()))
    assert len(parsers) > 30
    for parser in parsers:
        for action in parser._actions:
            assert action.help or isinstance(action, argparse._SubParsersAction), (parser.prog, action.dest)


def test_a_channel_has_no_message_ids_so_its_put_takes_none(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["put", "cam", "x", "--message-id", "one"])
    assert ended.value.code == 2
    assert "stampede put has no argument --message-id one" in capsys.readouterr().err


@pytest.mark.parametrize("ttl", ["0s", "-1h", "31d", "soon"])
def test_a_time_to_live_that_no_token_can_have_names_its_option(ttl: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["token", "issue", "cam", f"--ttl={ttl}"])
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert "--ttl" in told
    assert "nanos" not in told
