"""Attributes, content types, payloads, zones and errors of other programs never command the terminal. Each verb ends
quietly when its reader closes the pipe.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import stampede_rt as st
from stampede_rt.cli.commands import run
from stampede_rt.cli.verbs import SERVICE_VERBS, VERBS
from stampede_rt_local.cluster import LocalCluster
from tests.support.command_line.hostile_text import HOSTILE
from tests.support.command_line.terminal import run_in_terminal
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
Words = Callable[[Path], list[list[str]]]

# Each verb, with words that print texts of other programs. A verb that is not here fails the test below.
SHOWING: dict[str, Words] = {
    "ls": lambda _: [["ls"], ["ls", "-l"]],
    "info": lambda _: [["info", "hostile/a"], ["info", HOSTILE]],
    "hosts": lambda _: [["hosts"]],
    "move": lambda _: [["move", "hostile/a", HOSTILE]],
    "rebalance": lambda _: [["rebalance", "--over", "0.1s"]],
    "put": lambda _: [
        ["put", "hostile/put", HOSTILE],
        ["put", HOSTILE, "x"],
        ["put", "hostile/a", "x", "--time", HOSTILE],
    ],
    "rm": lambda _: [["rm", HOSTILE]],
    "configure": lambda _: [["configure", HOSTILE, "--max-age", "1s"]],
    "get": lambda _: [
        ["get", "hostile/a", "--all"],
        ["get", "hostile/a", "--format", "{payload}{attributes[k]}{content_type}"],
        ["get", "hostile/a", "--format", "{seq:c}"],
    ],
    "echo": lambda _: [["echo", "hostile/a", "--from", "oldest", "--count", "3"]],
    "sub": lambda _: [["sub", "hostile/a", "--from", "oldest", "--count", "3"]],
    "watch": lambda _: [["watch", HOSTILE, "--count", "x"]],
    "group": lambda _: [["group", "newest", "hostile/group"], ["group", "status", "hostile/group"], ["group", "ls"]],
    "queue": lambda _: [["queue", "get", "hostile/queue", "--keep"], ["queue", "ls", "-l"], ["queue", "info", HOSTILE]],
    "peers": lambda _: [["peers"], ["peers", HOSTILE]],
    "mailbox": lambda _: [["mailbox", "info", HOSTILE], ["mailbox", "send", HOSTILE, "x"]],
    "proxy": lambda _: [["proxy", "ls", HOSTILE]],
    "replicas": lambda _: [["replicas", "hostile/a"], ["replicas", HOSTILE]],
    "hz": lambda _: [["hz", "hostile/*", "--every", "0.1", "--count", "1"]],
    "bw": lambda _: [["bw", "hostile/a", "--every", "0.1", "--count", "1"]],
    "top": lambda _: [["top", "--every", "0.1", "--count", "1"]],
    "lag": lambda _: [["lag"]],
    "record": lambda path: [["record", "hostile/a", "--since", "oldest", "--for", "0s", "-o", str(path / "a.mcap")]],
    "replay": lambda path: [["replay", str(path / "a.mcap"), "--speed", "max"], ["replay", HOSTILE]],
    "import": lambda path: [["import", str(path / "a.mcap"), "--as", "in/"], ["import", HOSTILE]],
    "export": lambda path: [["export", "hostile/a", "-o", str(path / "a.csv")], ["export", HOSTILE, "-o", "a.csv"]],
    "file": lambda path: [["file", "info", str(path / "a.mcap")], ["file", "verify", HOSTILE]],
    "doctor": lambda _: [["doctor"]],
    "acl": lambda _: [["acl", "ls"], ["acl", "check", HOSTILE, "read", "channel", HOSTILE]],
    "quota": lambda _: [["quota", "ls"], ["quota", "check", HOSTILE]],
    "context": lambda _: [["context", "ls"], ["context", "use", HOSTILE], ["context", "add", HOSTILE, "--url", "a"]],
    "completion": lambda _: [["completion", HOSTILE]],
    "token": lambda _: [["token", "issue", HOSTILE]],
}
# The verbs that run parts of the system, with words that make them print texts of others, and end.
SERVICES: dict[str, Words] = {
    "dev": lambda _: [["dev", "--listen", HOSTILE], ["dev", HOSTILE]],
    "frontend": lambda _: [["frontend", "--listen", HOSTILE], ["frontend", HOSTILE]],
    "supernode": lambda path: [
        ["supernode", "--id", HOSTILE],
        ["supernode", HOSTILE],
        ["supernode", "status"],
        ["supernode", "add", HOSTILE],
        ["supernode", "remove", HOSTILE],
        ["supernode", "init", "--data-dir", str(path / "founded"), "--listen", HOSTILE],
    ],
    "host": lambda _: [["host", "--name", HOSTILE], ["host", HOSTILE], ["host", "drain", HOSTILE]],
    "web": lambda _: [["web", "--listen", HOSTILE], ["web", HOSTILE]],
    "certs": lambda path: [
        ["certs", "show", HOSTILE],
        ["certs", "init", str(path / HOSTILE)],
        ["certs", "issue", "--dir", str(path / HOSTILE), "--name", HOSTILE, "--role", "host"],
    ],
    "demo": lambda _: [["demo", HOSTILE]],
    "bench": lambda _: [["bench", HOSTILE]],
}
ENDLESS = {
    "echo": ["echo", "hostile/many", "--from", "oldest"],
    "sub": ["sub", "hostile/many", "--from", "oldest"],
    "get": ["get", "hostile/many", "--all"],
    "hz": ["hz", "hostile/many", "--every", "0.05"],
    "bw": ["bw", "hostile/many", "--every", "0.05"],
    "top": ["top", "hostile/*", "--every", "0.05"],
    "group": ["group", "ls"],
    "completion": ["completion", "bash"],
    "ls": ["ls"],
    "lag": ["lag"],
    "hosts": ["hosts", "-o", "json"],
    "doctor": ["doctor"],
}


@pytest.fixture(scope="module")
def hostile(cluster: LocalCluster) -> Iterator[None]:
    """A cluster whose items, messages and peer have hostile texts in all fields that take any text."""
    secret = cluster.secret_file.read_text().strip()
    with st.connect(cluster.address, secret=secret, name="hostile-peer", zone="z") as rt:
        channel = rt.channel("hostile/a", max_age="1h")
        kinds = ((HOSTILE.encode(), None), (f'"{HOSTILE}"'.encode(), "application/json"), (b"\xff", "\x1b]0;t\x07"))
        for payload, kind in kinds:
            channel.put(payload, attributes={HOSTILE: HOSTILE, "k": HOSTILE}, content_type=kind)
        many = rt.channel("hostile/many", max_age="1h")
        with many.producer() as producer:
            for _ in range(20_000):
                producer.put(b"x" * 50)
        rt.group("hostile/group", [channel, many])
        rt.queue("hostile/queue").put(HOSTILE.encode(), attributes={HOSTILE: HOSTILE})
        yield


@pytest.fixture(autouse=True)
def environment(cluster: LocalCluster, hostile: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(cluster.secret_file))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setenv("NO_COLOR", "1")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("files")


def test_every_verb_has_a_test_of_hostile_content() -> None:
    assert set(SHOWING) == set(VERBS)
    assert set(SERVICES) == set(SERVICE_VERBS)


@pytest.mark.parametrize("verb", [*VERBS, *SERVICE_VERBS])
def test_no_verb_writes_control_characters_of_others_to_a_terminal(verb: str, folder: Path) -> None:
    for words in (SHOWING | SERVICES)[verb](folder):
        screen = run_in_terminal(words, columns=120)
        assert screen.written, words
        assert "\x1b]" not in screen.written, words
        moves = {"\r"} if "\x1b[K" in screen.written else set()  # the line that shows progress
        assert screen.controls(moves_cursor=bool(moves) or verb == "top") <= moves, words
        assert "\x1b[2J" not in screen.written.replace("\x1b[2J", "", 1 if verb == "top" else 0), words
        assert "a defect" not in screen.written, words


@pytest.mark.parametrize("verb", ENDLESS)
def test_a_verb_ends_quietly_with_status_0_when_its_reader_closes_the_pipe(
    verb: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as output:
        monkeypatch.setattr(sys, "stdout", output)
        os.close(reading)  # as `head` does when it has read its line
        status = run(ENDLESS[verb])
        monkeypatch.undo()
    assert (status, capfd.readouterr().err) == (0, "")
