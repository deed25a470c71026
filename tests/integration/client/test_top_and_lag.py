"""`stampede top` in a pseudo-terminal, and `stampede lag`."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
SECONDS = 90
STAMPEDE = [sys.executable, "-m", "stampede_rt.cli"]


@pytest.fixture(autouse=True)
def _contents(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
    with st.connect(cluster.address) as rt:
        left, right = rt.channel("top/left", max_age="1h"), rt.channel("top/right")
        for _ in range(3):
            left.put(b"x" * 100)
        right.stats()  # the first call that reaches the host makes the channel there
        rt.group("top/both", [left, right])
        rt.queue("top/queue").put(b"x")


class Terminal:
    """A program in a pseudo-terminal of 100 columns and 30 lines."""

    def __init__(self, *words: str) -> None:
        self._own, other = pty.openpty()
        fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
        environment = os.environ | {"TERM": "xterm"}
        self.process = subprocess.Popen([*STAMPEDE, *words], stdin=other, stdout=other, stderr=other, env=environment)
        os.close(other)
        self.text = ""

    def until(self, pattern: str) -> None:
        """Read until the text matches."""
        end_s = time.monotonic() + SECONDS
        while not re.search(pattern, self.text):
            assert time.monotonic() < end_s, self.text[-2000:]
            if select.select([self._own], [], [], 0.2)[0]:
                self.text += os.read(self._own, 65536).decode(errors="replace")

    def press(self, keys: str) -> None:
        self.text = ""
        os.write(self._own, keys.encode())

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._own)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal("top", "top/*", "--every", "0.2")
    yield made
    made.close()


def test_stampede_top_shows_channels_and_obeys_its_keys(terminal: Terminal) -> None:
    terminal.until(r"2 channels, sorted by bytes")
    terminal.until(r"top/left\s+\d")
    terminal.press("s")
    terminal.until("sorted by items")
    terminal.press("/right\n")
    terminal.until("1 channels, .*filter: right")
    terminal.press("p")
    terminal.until("paused")
    terminal.press("q")
    assert terminal.process.wait(SECONDS) == 0


def test_stampede_top_without_a_terminal_prints_lines_for_programs() -> None:
    done = subprocess.run(
        [*STAMPEDE, "top", "top/*", "--every", "0.1", "--count", "2"], capture_output=True, text=True, check=True
    )
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["channel"] for row in rows] == ["top/left", "top/right"] * 2
    assert rows[0]["held"] == 3 * (rows[0]["held"] // 3) > 0


def test_lag_names_each_kind_of_thing_and_the_member_that_holds_a_group_back() -> None:
    done = subprocess.run([*STAMPEDE, "lag", "top/*", "-o", "json"], capture_output=True, text=True, check=True)
    rows = {(row["kind"], row["name"]): row for row in json.loads(done.stdout)}
    assert set(rows) == {("channel", "top/left"), ("group", "top/both"), ("queue", "top/queue")}
    assert rows["group", "top/both"]["because"] == "top/right"
    assert rows["queue", "top/queue"]["lag_nanos"] > 0
    assert rows["queue", "top/queue"]["waiting"] > 0


def test_lag_prints_a_table_and_a_sentence_if_nothing_lags() -> None:
    done = subprocess.run([*STAMPEDE, "lag", "top/left"], capture_output=True, text=True, check=True)
    assert re.search(r"channel\s+top/left", done.stdout)
    none = subprocess.run([*STAMPEDE, "lag", "absent"], capture_output=True, text=True, check=True)
    assert none.stdout == "no channel, group or queue matches 'absent', or all are empty\n"
