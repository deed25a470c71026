"""`stampede queue`, `stampede mailbox` and `stampede peers`, as their users read them."""

from __future__ import annotations

import json
import re
import sys
import tempfile
from collections.abc import Callable

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
Run = Callable[..., tuple[str, str]]


@pytest.fixture
def stampede(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command. Returns its output on stdout and on stderr."""
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)

    def run(*arguments: str, status: int = 0) -> tuple[str, str]:
        found = main(arguments)
        printed = capsys.readouterr()
        assert found == status, printed
        return printed.out, printed.err

    return run


def test_a_queued_message_is_delivered_once(stampede: Run) -> None:
    assert stampede("queue", "put", "cli/jobs", "do it", "--attribute", "by=me") == ("cli/jobs #1\n", "")
    shown, _ = stampede("queue", "get", "cli/jobs", "--keep")
    assert shown.endswith("#1 by=me  do it\n")
    shown, _ = stampede("queue", "get", "cli/jobs", "-n", "5", "--timeout", "0.1")
    assert shown.endswith("#1 (delivery 2) by=me  do it\n")
    assert stampede("queue", "get", "cli/jobs", "--timeout", "0", status=3) == ("", "stampede: there is no message\n")
    _, error_output = stampede("queue", "get", "cli/jobs", "--timeout", "0.1", status=3)
    assert error_output == "stampede: no message came within 0.1 s\n"


def test_programs_read_and_write_json(stampede: Run) -> None:
    printed, _ = stampede("queue", "put", "cli/json", "x", "-o", "json")
    assert json.loads(printed) == {"queue": "cli/json", "seq": 1, "duplicate": False}
    printed, _ = stampede("queue", "get", "cli/json", "-o", "jsonl")
    row = json.loads(printed)
    assert (row["seq"], row["payload"], row["deliveries"], row["length_bytes"]) == (1, "x", 1, 1)
    printed, _ = stampede("queue", "info", "cli/json", "-o", "json")
    facts = json.loads(printed)
    assert (facts["consumed"], facts["held"], facts["oldest_age"], facts["rejected"]["full"]) == (1, 0, None, 0)


def test_the_policy_of_a_queue_in_use_is_changed(stampede: Run) -> None:
    stampede("queue", "put", "cli/jobs-dead", "x")
    stampede("queue", "put", "cli/changed", "x", "--max-items", "5")
    changed, _ = stampede("queue", "configure", "cli/changed", "--lease", "2m", "--dead-letter", "cli/jobs-dead")
    assert "5 items, lease 2 m, dead letters to cli/jobs-dead" in changed
    printed, _ = stampede("queue", "configure", "cli/changed", "--max-deliveries", "3", "-o", "json")
    facts = json.loads(printed)
    assert facts["queue"] == "cli/changed"
    assert "3 deliveries" in facts["policy"]
    assert facts["policy"] in stampede("queue", "info", "cli/changed")[0]
    _, why = stampede("queue", "configure", "cli/changed", status=2)
    assert "state at least one setting" in why
    _, why = stampede("queue", "configure", "cli/absent", "--lease", "2m", status=1)
    assert "there is no queue cli/absent" in why


def test_standard_input_is_put_and_payloads_are_printed_raw(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)
    with tempfile.TemporaryFile() as file:
        file.write(b"\x00\xff")
        file.seek(0)
        monkeypatch.setattr(sys, "stdin", file)
        assert main(["queue", "put", "cli/raw"]) == 0
    capfdbinary.readouterr()
    assert main(["queue", "get", "cli/raw", "--raw"]) == 0
    assert capfdbinary.readouterr().out == b"\x00\xff"


def test_a_message_id_is_put_once(stampede: Run) -> None:
    assert stampede("queue", "put", "cli/once", "x", "--message-id", "one")[0] == "cli/once #1\n"
    assert stampede("queue", "put", "cli/once", "x", "--message-id", "one")[0] == (
        "cli/once #1 (the queue has this message id already)\n"
    )


def test_pending_messages_are_listed(stampede: Run, cluster: LocalCluster) -> None:
    assert stampede("queue", "put", "cli/pending", "x")[0] == "cli/pending #1\n"
    assert stampede("queue", "pending", "cli/pending")[0] == "no message of cli/pending is leased\n"
    with st.connect(cluster.address, name="cli-taker") as rt:
        rt.queue("cli/pending").get(timeout=10)
        header, row = stampede("queue", "pending", "cli/pending")[0].splitlines()
        assert header.split() == ["SEQ", "TAKER", "TAKER", "ID", "DELIVERIES", "LEASED", "EXPIRES"]
        assert row.split()[:2] == ["1", "cli-taker"]
        (found,) = json.loads(stampede("queue", "pending", "cli/pending", "-o", "json")[0])
        assert (found["seq"], found["taker"], found["deliveries"]) == (1, "cli-taker", 1)
        assert found["expires"] - found["leased"] == 30 * 10**9
        rt.send("cli-taker", b"x")
        assert rt.mailbox.get(timeout=10)
        assert "cli-taker" in stampede("mailbox", "pending", "cli-taker")[0]
    _, error_output = stampede("mailbox", "pending", "cli-taker", status=1)
    assert "no live peer is named cli-taker" in error_output


def test_a_message_is_terminated_with_a_reason_and_its_dead_letter_has_it(stampede: Run) -> None:
    stampede("queue", "put", "cli/dead", "x")
    stampede("queue", "get", "cli/dead")
    stampede("queue", "put", "cli/term", "poison", "--dead-letter", "cli/dead")
    stampede("queue", "get", "cli/term", "--term", "no\nimage")
    shown, _ = stampede("queue", "get", "cli/dead", "--timeout", "10", "--keep")
    message, origin = shown.splitlines()
    assert message.endswith("poison")
    assert origin.startswith("    left cli/term #1, put ")
    assert ", at delivery 1, terminated by " in origin
    assert origin.endswith(r": no\nimage")
    row = json.loads(stampede("queue", "get", "cli/dead", "-o", "jsonl")[0])
    assert (row["origin"]["queue"], row["origin"]["ended"], row["origin"]["reason"]) == (
        "cli/term",
        "terminated",
        "no\nimage",
    )


def test_queues_are_listed_with_their_policy_and_counters(stampede: Run) -> None:
    stampede("queue", "put", "cli/list/failed", "x")
    stated = ("--lease", "10s", "--max-items", "9", "--max-deliveries", "3", "--dead-letter", "cli/list/failed")
    stampede("queue", "put", "cli/list/jobs", "x", *stated)
    table, _ = stampede("queue", "ls", "cli/list/*", "-l")
    header, failed, jobs = table.splitlines()
    assert "  lease 30 s  " in failed
    counters = ["HELD", "LEASED", "ACCEPTED", "CONSUMED"]
    assert re.split("  +", header) == ["QUEUE", "HOST", "POLICY", "EPOCH", "CREATED BY", *counters]
    assert failed.split()[:2] == ["cli/list/failed", "h1"]
    assert "9 items, lease 10 s, 3 deliveries, dead letters to cli/list/failed" in jobs
    rows = json.loads(stampede("queue", "ls", "cli/list/*", "-o", "json")[0])
    assert [row["queue"] for row in rows] == ["cli/list/failed", "cli/list/jobs"]
    assert stampede("queue", "ls", "nothing/*")[0] == "no queue matches 'nothing/*'\n"
    info, _ = stampede("queue", "info", "cli/list/jobs")
    assert "policy          9 items, lease 10 s, 3 deliveries, dead letters to cli/list/failed\n" in info


def test_a_queue_is_deleted(stampede: Run) -> None:
    stampede("queue", "put", "cli/gone", "x")
    assert stampede("queue", "delete", "cli/gone") == ("cli/gone is deleted\n", "")
    for verb in ("get", "info", "delete"):
        _, error_output = stampede("queue", verb, "cli/gone", status=1)
        assert error_output.startswith("stampede: there is no queue cli/gone; `stampede queue ls` lists the queues")


def test_a_policy_that_differs_from_the_present_policy_of_the_queue_is_refused(stampede: Run) -> None:
    stampede("queue", "put", "cli/stated", "x", "--max-items", "5")
    _, error_output = stampede("queue", "put", "cli/stated", "x", "--max-items", "6", status=1)
    assert "max_items 5" in error_output


def test_a_peer_takes_a_message_that_was_sent_to_it(stampede: Run, cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="cli/robot", zone="lab") as rt:
        assert stampede("mailbox", "send", "cli/robot", "go") == ("cli/robot #1\n", "")
        info, _ = stampede("mailbox", "info", "cli/robot")
        assert "held            1\n" in info
        message = rt.mailbox.get(timeout=10)
        assert message is not None
        assert message.payload == b"go"
        table, _ = stampede("peers", "cli/*")
        header, robot = table.splitlines()
        columns = ["PEER", "ALIVE", "SINCE", "MAILBOX", "HOST", "ZONE", "VERSION", "OWNER", "CLOCK OFFSET"]
        assert re.split("  +", header) == columns
        assert robot.split()[:2] == ["cli/robot", "yes"]
        assert " +/- " in robot
        (row,) = json.loads(stampede("peers", "cli/*", "-o", "json")[0])
        assert (row["peer"], row["alive"], row["mailbox"], row["zone"]) == ("cli/robot", True, True, "lab")
        assert abs(row["clock"]["offset_nanos"]) <= row["clock"]["uncertainty_nanos"]
        _, error_output = stampede("mailbox", "get", "cli/robot", status=1)
        assert "another live peer has the name" in error_output


def test_sending_to_an_absent_peer_fails(stampede: Run) -> None:
    for verb in (("send", "cli/nobody", "x"), ("info", "cli/nobody")):
        _, error_output = stampede("mailbox", *verb, status=1)
        assert error_output == "stampede: no live peer is named cli/nobody; `stampede peers` lists the live ones\n"
    assert stampede("peers", "nothing/*")[0] == "no peer matches 'nothing/*'\n"


def test_a_command_is_a_peer_while_it_runs(stampede: Run) -> None:
    _, error_output = stampede("mailbox", "get", "cli/short", "--timeout", "0.1", status=3)
    assert error_output == "stampede: no message came within 0.1 s\n"
