"""Addresses that only this machine can call, in a list with addresses of other machines: refused before anything is
written.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt_runtime.settings import SettingsError, load_settings
from stampede_rt_supernode.app import main
from stampede_rt_supernode.joining import preparing
from stampede_rt_supernode.settings import SupernodeSettings

HERE = ["localhost:7590", "127.0.0.1:7590", "[::1]:7590"]
ELSEWHERE = "10.0.0.5:7590"


def cluster_at(*targets: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `join` find a cluster whose members have these addresses."""
    members = [
        SimpleNamespace(supernode_id=f"s{number}", endpoint=SimpleNamespace(target=target))
        for number, target in enumerate(targets, 1)
    ]
    listed = SimpleNamespace(supernodes=members)

    @contextmanager
    def reached(*_: Any) -> Iterator[Any]:
        yield SimpleNamespace(members=lambda: listed, make_token=lambda **_: SimpleNamespace(token="c.1.t"))

    monkeypatch.setattr(preparing, "reached", reached)


def join(folder: Path, *words: str) -> int:
    return main(["join", "--data-dir", str(folder), "--id", "s9", "--token", "c.1.t", *words])


@pytest.mark.parametrize("address", HERE)
@pytest.mark.parametrize("option", ["--listen", "--advertise"])
def test_a_newcomer_that_others_cannot_call_may_not_join_members_elsewhere(
    address: str,
    option: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cluster_at(ELSEWHERE, monkeypatch=monkeypatch)
    words = ("--listen", address) if option == "--listen" else ("--listen", "0.0.0.0:7590", "--advertise", address)
    assert join(tmp_path / "s9", *words) == 2
    error_output = capsys.readouterr().err
    assert f"{address} can be called only from its own machine" in error_output
    assert f"s1 at {ELSEWHERE}" in error_output
    assert "give --listen or --advertise the address at which they reach this supernode" in error_output
    assert not (tmp_path / "s9").exists()


@pytest.mark.parametrize("address", HERE)
def test_a_newcomer_elsewhere_may_not_join_members_that_it_cannot_call(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cluster_at(address, monkeypatch=monkeypatch)
    assert join(tmp_path / "s9", "--listen", ELSEWHERE) == 2
    error_output = capsys.readouterr().err
    assert f"s1 at {address} can be called only from its own machine" in error_output
    assert "stampede supernode init --advertise" in error_output
    assert not (tmp_path / "s9").exists()


def test_either_all_or_no_addresses_of_a_list_of_members_are_loopback_addresses(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["--id", "s1", "--listen", "localhost:7581", "--members", f"s1=localhost:7581,s2={ELSEWHERE}"]
    assert main(words) == 2
    error_output = capsys.readouterr().err
    assert "--members names s1=localhost:7581, which only its own machine can call" in error_output
    assert "give each the address at which the others reach it" in error_output


@pytest.mark.parametrize("source", ["flag", "variable", "file"])
@pytest.mark.parametrize("address", HERE)
def test_a_mixed_list_of_members_is_refused_wherever_it_was_written(address: str, source: str, tmp_path: Path) -> None:
    mixed = f"s1={address},s2={ELSEWHERE}"
    words = ["--id", "s1", "--listen", address]
    environment = {}
    if source == "flag":
        words += ["--members", mixed]
    elif source == "variable":
        environment["STAMPEDE_SUPERNODE_MEMBERS"] = mixed
    else:
        file = tmp_path / "settings.toml"
        file.write_text(f'[supernode]\nmembers = ["s1={address}", "s2={ELSEWHERE}"]\n')
        words += ["--config", str(file)]
    with pytest.raises(SettingsError, match="which only its own machine can call"):
        load_settings(SupernodeSettings, service="supernode", argv=words, environ=environment)


@pytest.mark.parametrize("addresses", [("localhost:1", "[::1]:2"), ("10.0.0.5:1", "host.example:2")])
def test_a_list_of_members_that_can_call_each_other_is_accepted(addresses: tuple[str, str]) -> None:
    members = tuple(f"s{number}={address}" for number, address in enumerate(addresses, 1))
    assert SupernodeSettings(id="s1", listen="localhost:1", members=members).members == members
