"""The addresses that count as this machine's own, and the servers that get the user's own secret."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt.cluster.addresses import is_loopback
from stampede_rt.cluster.connecting import parse_target


@pytest.mark.parametrize(
    "target", ["localhost:7580", "LOCALHOST:7580", "127.0.0.1:1", "127.8.0.1:1", "[::1]:1", "unix:/x"]
)
def test_a_loopback_address_is_recognised(target: str) -> None:
    assert is_loopback(target)


@pytest.mark.parametrize(
    "target",
    [
        "10.0.0.1:7580",
        "rig:7580",
        "[2001:db8::1]:7580",
        "0.0.0.0:7580",
        "localhost.evil.example:7580",
        "127.0.0.1.evil.example:7580",
        "127.evil.example:7580",
        "a.localhost:7580",  # a resolver may ask the network for it
    ],
)
def test_an_address_that_may_be_of_another_machine_does_not_count_as_this_machine(target: str) -> None:
    assert not is_loopback(target)


@pytest.mark.parametrize("url", ["localhost.evil.example", "127.0.0.1.evil.example:7580", "localhost,evil.example"])
def test_the_users_own_secret_is_sent_to_no_other_machine(
    url: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    place = tmp_path / "stampede" / "secret"
    place.parent.mkdir()
    place.touch(mode=0o600)
    place.write_text("the-secret")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)

    def parsed(url: str) -> str | None:
        return parse_target(url, name=None, secret=None, zone=None).credentials.present_secret()

    assert parsed("localhost:7580") == "the-secret"
    assert parsed(url) is None
    assert "the-secret" not in repr(parse_target("localhost:7580", name=None, secret=None, zone=None))
