"""Each sample of a settings file in deploy/settings: its service prints the same text, and starts with it."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from stampede_rt_channel_host.app import main as host
from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_frontend.app import main as frontend
from stampede_rt_frontend.settings import FrontendSettings
from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceProcess
from stampede_rt_runtime.auth import make_secret_file
from stampede_rt_runtime.settings import load_settings
from stampede_rt_supernode.app import main as supernode
from stampede_rt_supernode.settings import SupernodeSettings
from stampede_rt_web.app import main as web
from stampede_rt_web.settings import WebSettings
from tests.support.live_page import ANSWER_SECONDS, READY_SECONDS, LivePage, eventually

FOLDER = Path(__file__).resolve().parents[3] / "deploy/settings"
SERVICES: dict[str, tuple[Callable[[list[str]], int], type[Any]]] = {
    "supernode": (supernode, SupernodeSettings),
    "frontend": (frontend, FrontendSettings),
    "host": (host, HostSettings),
    "web": (web, WebSettings),
}
REQUIRED = {"frontend": {"supernodes": ("localhost:7590",)}}


def test_every_service_has_its_sample() -> None:
    assert {path.name for path in FOLDER.iterdir()} == {f"{service}.toml" for service in SERVICES}


@pytest.mark.parametrize("service", SERVICES)
def test_a_settings_sample_equals_the_output_of_its_service(service: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert SERVICES[service][0](["--sample-settings"]) == 0
    assert capsys.readouterr().out == (FOLDER / f"{service}.toml").read_text(), (
        f"write it again: stampede {service} --sample-settings > deploy/settings/{service}.toml"
    )


@pytest.mark.parametrize("service", SERVICES)
def test_a_sample_loads_as_it_is_and_with_every_default_set(service: str, tmp_path: Path) -> None:
    cls = SERVICES[service][1]
    defaults = cls(**REQUIRED.get(service, {}))
    text = (FOLDER / f"{service}.toml").read_text()
    every_default = re.sub(r'^#(?! )(?!.* = "[A-Z=:,.]+"$)', "", text, flags=re.MULTILINE)
    assert every_default.count("\n#") < text.count("\n#")
    for number, content in enumerate((text, every_default)):
        path = tmp_path / f"{number}.toml"
        path.write_text(content)
        assert load_settings(cls, service=service, argv=["--config", str(path)], environ={}) == defaults


def edited(service: str, folder: Path, **settings: str) -> str:
    """The path of a copy of a sample, with these settings as a user would write them."""
    text = (FOLDER / f"{service}.toml").read_text()
    for name, value in settings.items():
        key = name.replace("_", "-")
        text, count = re.subn(rf"^#?{key} = .*$", f'{key} = "{value}"', text, flags=re.MULTILINE)
        assert count == 1, (service, key)
    path = folder / f"{service}.toml"
    path.write_text(text)
    return str(path)


def test_each_service_starts_from_its_sample_with_no_other_option(tmp_path: Path) -> None:
    secret = str(make_secret_file(tmp_path / "secret").path)
    supernode, frontend, page = (f"localhost:{port}" for port in free_ports(3, "localhost"))
    samples = {
        "supernode": {"listen": supernode, "id": "s1"},
        "frontend": {"listen": frontend, "supernodes": supernode},
        "host": {"listen": "localhost:0", "frontend": frontend, "name": "h1"},
        "web": {"listen": page, "url": frontend},
    }
    with contextlib.ExitStack() as stack:
        for service, settings in samples.items():
            path = edited(service, tmp_path, **settings, secret_file=secret, log_level="warning")
            process = ServiceProcess(service, "stampede_rt.cli", [service, "--config", path])
            stack.callback(process.stop)
            process.start()
            process.wait_ready(READY_SECONDS)
        overview = eventually(lambda: hosts_on(LivePage(f"http://{page}/")))
        assert [one["name"] for one in overview] == ["h1"]
        with urlopen(f"http://{page}/", timeout=ANSWER_SECONDS) as answer:
            assert b"<title>" in answer.read()


def hosts_on(page: LivePage) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = page.ask("overview")[1].get("hosts", [])
    return found
