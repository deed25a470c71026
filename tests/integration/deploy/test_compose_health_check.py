"""The health check of the containers, against a real server."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from stampede_rt_local.ports import free_ports
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.health_check import main, own_address, status_of
from stampede_rt_runtime.server import serving


async def test_a_serving_service_is_healthy_even_if_it_asks_everyone_for_the_secret(tmp_path: Path) -> None:
    async with serving(lambda _: None, secret=Secret(text="s3cret", path=tmp_path / "secret")) as server:
        assert await asyncio.to_thread(status_of, server.address) == "SERVING"


async def test_a_service_that_is_not_ready_is_not_healthy() -> None:
    async with serving(lambda _: None) as server:
        await server.set_serving(False)
        assert await asyncio.to_thread(main, [server.address]) == 1


async def test_the_health_command_of_the_images_prints_its_finding() -> None:
    async with serving(lambda _: None) as server:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "stampede_rt_runtime.health_check"),
            env={"STAMPEDE_LISTEN": server.address},
            stdout=asyncio.subprocess.PIPE,
        )
        output, _ = await process.communicate()
    assert process.returncode == 0
    assert output.decode().strip() == f"{server.address}: SERVING"


def test_an_address_without_a_service_is_not_healthy(capsys: pytest.CaptureFixture[str]) -> None:
    (port,) = free_ports(1, "localhost")
    assert main([f"localhost:{port}"]) == 1
    assert "UNAVAILABLE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("listens", "called"),
    [("0.0.0.0:7590", "127.0.0.1:7590"), ("[::]:7590", "[::1]:7590"), ("supernode-1:7590", "supernode-1:7590")],
)
def test_a_wildcard_is_called_at_loopback(listens: str, called: str) -> None:
    assert own_address([], {"STAMPEDE_LISTEN": listens}) == called


def test_an_argument_wins_over_the_environment() -> None:
    assert own_address(["localhost:1"], {"STAMPEDE_LISTEN": "localhost:2"}) == "localhost:1"


@pytest.mark.parametrize(
    ("argv", "complaint"),
    [([], "STAMPEDE_LISTEN"), (["a:1", "b:2"], "one HOST:PORT"), (["7590"], "HOST:PORT"), (["a:0"], "not 0")],
)
def test_the_check_distinguishes_a_bad_address_from_an_unhealthy_service(
    argv: list[str], complaint: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("STAMPEDE_LISTEN", raising=False)
    assert main(argv) == 2
    assert complaint in capsys.readouterr().err
