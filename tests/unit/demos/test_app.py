"""`stampede demo`: the list, the arguments, and failures in one sentence."""

import signal

import pytest

from stampede_rt_demos import app
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging import film


def test_without_a_name_the_demos_are_listed(capsys):
    assert app.main([]) == 0
    assert "tv-watcher" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words", [["no-such-demo"], ["tv-watcher", "--seconds", "1"], ["tv-watcher", "--seconds", "x"]]
)
def test_bad_arguments_are_refused_before_anything_starts(words, capsys):
    with pytest.raises(SystemExit) as end:
        app.main(words)
    assert end.value.code == 2
    assert "usage" in capsys.readouterr().err


def test_a_failure_is_one_sentence_and_exit_code_1(monkeypatch, capsys):
    monkeypatch.setattr(film, "_LIBRARIES", {"no_such_decoder": "no-such-decoder"})
    monkeypatch.setattr(app, "require_libraries", film.require_libraries)
    assert app.main(["tv-watcher"]) == 1
    error_output = capsys.readouterr().err
    assert error_output.startswith("stampede demo tv-watcher: the package no-such-decoder")
    assert error_output.count("\n") == 1


def test_an_interruption_is_reported_and_has_the_shells_exit_code(monkeypatch, capsys):
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "require_libraries", interrupted)
    assert app.main(["tv-watcher"]) == 130
    assert "nothing is left running" in capsys.readouterr().err


def test_a_picture_that_cannot_be_written_is_found_out_immediately(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert app.main(["tv-watcher", "--picture", str(tmp_path / "file" / "picture.png")]) == 1
    assert "picture" in capsys.readouterr().err
    assert app.main(["tv-watcher", "--picture", str(tmp_path)]) == 1
    assert "name a file" in capsys.readouterr().err


def test_the_callers_signal_handlers_are_left_as_they_were(monkeypatch):
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(film, "_FILM_PACKAGE", "no_such_package")
    assert app.main(["tv-watcher"]) == 1
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_cluster_that_does_not_start_is_one_sentence(monkeypatch, capsys):
    def fail(seconds: int, progress: object, *, certificates: bool) -> None:
        raise DemoFailed("the cluster did not start: supernode s1 ended with exit code 1")

    monkeypatch.setattr("stampede_rt_demos.tv_watcher.app.conduct", fail)
    assert app.main(["tv-watcher"]) == 1
    assert capsys.readouterr().err.count("\n") == 1
