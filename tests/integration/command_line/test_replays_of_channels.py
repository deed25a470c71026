"""`stampede replay` of channels, as typed at a shell: the items between two instants, or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

import stampede_rt as st
from stampede_rt.cli.main import main
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


@pytest.fixture
def run(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Run a command. Returns its exit status and its output."""
    monkeypatch.setenv("STAMPEDE_URL", cluster.address)

    def command(*words: str) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main(list(words))
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return command


def test_a_replay_ignores_later_items_when_it_checks_what_the_channel_takes(run: Command, rt: st.Connection) -> None:
    channel, began = rt.channel("until/cam", max_age="60s"), st.now() - 30 * 10**9
    for number in range(10):
        channel.put(b"%d" % number, time=began + number * 10**9)
    words = ("--from", str(began), "--to", str(began + 2 * 10**9), "--as", "cut/", "--speed", "max", "--shift", "now")
    status, out, told = run("replay", "until/cam", *words)
    assert (status, out.splitlines()[1:2]) == (0, ["cut/until/cam      2"]), told
