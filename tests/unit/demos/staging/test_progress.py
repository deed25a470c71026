"""The form of the progress text depends on its output: a terminal, or a file."""

import io

from stampede_rt_demos.staging.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_without_a_terminal_a_plain_line_comes_every_few_seconds():
    output, times = io.StringIO(), iter([0.0, 1.0, 3.9, 4.1, 5.0])
    progress = Progress(output, monotonic=lambda: next(times))
    for number in range(5):
        progress.show(f"line {number}")
    progress.close()
    assert output.getvalue() == "line 0\nline 3\n"


def test_on_a_terminal_one_line_is_overwritten_and_taken_away_at_the_end():
    output = Terminal()
    progress = Progress(output)
    progress.show("one")
    progress.show("two")
    progress.close()
    progress.close()
    assert output.getvalue() == "\r\x1b[Kone\r\x1b[Ktwo\r\x1b[K"


def test_on_a_terminal_a_line_is_cut_to_its_width(monkeypatch):
    monkeypatch.setenv("COLUMNS", "10")
    output = Terminal()
    Progress(output).show("0123456789abcdef")
    assert output.getvalue() == "\r\x1b[K012345678"


def test_a_lasting_line_replaces_the_temporary_one():
    output = Terminal()
    progress = Progress(output)
    progress.show("passing")
    progress.print_line("staying")
    assert output.getvalue() == "\r\x1b[Kpassing\r\x1b[Kstaying\n"
