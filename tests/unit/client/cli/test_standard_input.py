"""Standard input as payloads. Each program is a process of its own, whose input stays open."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

from tests.support.processes import started

PATIENCE_S = 60
PRELUDE = """
    import os, signal, sys
    from stampede_rt.cli import interrupts
    from stampede_rt.cli.standard_input import read_all, read_lines

    def run(work, regular=True):
        def begin():
            if regular:
                interrupts.interruption.set_regular_end(lambda: None, 1e9)
            return work()
        sys.exit(interrupts.run_interruptibly(begin))

    def ctrl_c():
        os.kill(os.getpid(), signal.SIGINT)
"""


def ended(program: str, typed: str, *, closed: bool = False) -> tuple[int, str]:
    """The exit status and the output of a program. Its input stays open after `typed`, unless it is `closed`."""
    source = textwrap.dedent(PRELUDE) + textwrap.dedent(program)
    with started([sys.executable, "-c", source], stderr=subprocess.STDOUT) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(typed)
        process.stdin.flush()
        if closed:
            process.stdin.close()
        out = process.stdout.read()
        process.wait(PATIENCE_S)
    return process.returncode, out


def test_ctrl_c_ends_the_wait_for_a_line_and_leaves_out_half_a_line() -> None:
    program = """
    def work():
        lines = read_lines()
        print(next(lines))
        ctrl_c()
        print(list(lines))
        return 0

    run(work)
    """
    assert ended(program, "one\nhal") == (0, "b'one'\n[]\n")


def test_ctrl_c_ends_the_wait_for_a_payload_and_nothing_is_put() -> None:
    program = """
    def work():
        ctrl_c()
        print("put", read_all(100, "too long"))
        return 0

    run(work, regular=False)
    """
    assert ended(program, "half a payload") == (130, "")


@pytest.mark.parametrize(("typed", "lines"), [("a\n\nb", [b"a", b"", b"b"]), ("", []), ("\n", [b""])])
def test_all_lines_up_to_the_end_of_the_input_are_read(typed: str, lines: list[bytes]) -> None:
    assert ended("run(lambda: print(list(read_lines())) or 0)", typed, closed=True) == (0, f"{lines}\n")


def test_a_line_that_is_too_long_is_refused_before_its_end() -> None:
    program = """
    from stampede_rt.cli import standard_input
    from stampede_rt.errors import InvalidArgument

    def work():
        standard_input.PAYLOAD_BYTES_MAX = 10
        try:
            return len(list(read_lines()))
        except InvalidArgument as error:
            print(error.message)
            return 2

    run(work)
    """
    assert ended(program, "x" * 11) == (2, "a line has more than 10 bytes, the greatest size of one item\n")
