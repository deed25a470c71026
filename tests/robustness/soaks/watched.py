"""A soak of the live page: `python -m tests.robustness.soaks.watched --minutes 10` (also `make soak-page`).

Chromium shows the page of a real cluster all the time, while programs put and read. Each part in turn is killed with
SIGKILL and started again, also the server of the page. After each kill an item with a new text comes. The open tab must
then show this text, every host as alive, and no complaint. The tab never loads the page again. The memory of the page's
server must stay bounded. Needs Debian's chromium.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import os
import shutil
import time
from pathlib import Path
from typing import Any

from playwright.async_api import Error as BrowserError
from playwright.async_api import async_playwright

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.ports import free_ports
from stampede_rt_local.process import ServiceProcess
from tests.robustness.soaks.scraped import put_forever

CHANNELS = 20
PAGE = "the page"
TOLD = "a/told"
"""The channel of the item that comes after each kill. The page shows cards of the first rows only, and this name is the
first one in their order.
"""
BACK_SECONDS_MAX = 60.0
PAGE_BYTES_MAX = 200 * 2**20
"""The most resident memory of the page's server. With one tab it has about 70 MiB."""
SHOWS_PRESENT_STATE = """([name, text, hosts]) => {
  const card = [...document.querySelectorAll(".card")].find((one) => one.getAttribute("aria-label") === name);
  const panels = [...document.querySelectorAll(".panel")];
  const cells = panels.find((one) => one.textContent.startsWith("Hosts"))?.querySelectorAll("tbody tr td:nth-child(2)");
  const alive = [...(cells ?? [])].filter((one) => one.textContent === "lives").length;
  return card?.querySelector("pre")?.textContent === text && alive === hosts
    && document.getElementById("trouble").hidden;
}"""


class Watcher:
    """The open tab, the server of the page, and the errors so far."""

    def __init__(self, cluster: LocalCluster, server: ServiceProcess, tab: Any) -> None:
        self._cluster, self.server, self._tab = cluster, server, tab
        self.kills: list[tuple[str, float]] = []
        self.bytes_max = 0
        self.wrong: list[str] = []

    async def kill_each(self, until_s: float) -> None:
        """Kill the parts in turn, and look at the tab after each kill."""
        cluster = self._cluster
        parts = [*cluster.supernodes, *cluster.hosts, *cluster.frontends, self.server]
        for number, process in enumerate(itertools.cycle(parts)):
            if time.monotonic() >= until_s and number >= len(parts):
                return
            self._note_memory()
            await asyncio.to_thread(_kill, process)
            began_s = time.monotonic()
            try:
                await asyncio.wait_for(self._see(f"after kill {number}"), BACK_SECONDS_MAX)
            except (TimeoutError, BrowserError):
                shown = await self._tab.locator("#trouble").inner_text()
                self.wrong.append(
                    f"kill {number} of {process.name}: the tab does not show the present state; it says {shown!r}"
                )
            self.kills.append((process.name, time.monotonic() - began_s))

    async def _see(self, text: str) -> None:
        await self._put_text(text)
        arguments = [TOLD, text, len(self._cluster.hosts)]
        await self._tab.wait_for_function(SHOWS_PRESENT_STATE, arg=arguments, timeout=1000 * BACK_SECONDS_MAX)

    async def _put_text(self, text: str) -> None:
        async with aio.connect(self._cluster.address, secret=self._cluster.secret_file) as rt:
            while True:
                with contextlib.suppress(st.StampedeError):
                    channel = await rt.channel(TOLD, max_items=100, content_type="text/plain")
                    await channel.put(text.encode(), timeout=5)
                    return
                await asyncio.sleep(0.1)

    def _note_memory(self) -> None:
        self.bytes_max = max(self.bytes_max, _resident_bytes(self.server.pid))
        if self.bytes_max > PAGE_BYTES_MAX:
            self.wrong.append(f"the page's server has {self.bytes_max / 2**20:.0f} MiB")


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _kill(process: ServiceProcess) -> None:
    process.kill()
    process.start()
    process.wait_ready(BACK_SECONDS_MAX)


async def soak(minutes: float, picture: Path | None) -> int:
    """Run the soak. Returns the exit status. `picture`: the file for a picture of the tab at the end."""
    with LocalCluster(hosts=2, supernodes=3, log_level="error") as cluster:
        os.environ["STAMPEDE_SECRET_FILE"] = str(cluster.secret_file)
        listen = f"localhost:{free_ports(1)[0]}"
        words = ["--listen", listen, "--url", cluster.address, "--secret-file", str(cluster.secret_file)]
        server = ServiceProcess(PAGE, "stampede_rt_web", words)
        server.start()
        try:
            url = server.wait_ready(BACK_SECONDS_MAX)
            async with async_playwright() as started:
                browser = await started.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
                tab = await browser.new_page(viewport={"width": 1280, "height": 800})
                await tab.goto(url)
                watcher = Watcher(cluster, server, tab)
                status = await _soak(cluster, watcher, minutes)
                if picture is not None:
                    await tab.screenshot(path=picture, full_page=True)
                await browser.close()
                return status
        finally:
            server.stop()


async def _soak(cluster: LocalCluster, watcher: Watcher, minutes: float) -> int:
    putting = [asyncio.create_task(put_forever(cluster.address, cluster.secret_file, one)) for one in range(CHANNELS)]
    try:
        await watcher.kill_each(time.monotonic() + 60 * minutes)
    finally:
        for one in putting:
            one.cancel()
        ended = await asyncio.gather(*putting, return_exceptions=True)
    wrong = watcher.wrong + [f"a program failed: {e!r}" for e in ended if not isinstance(e, asyncio.CancelledError)]
    slowest, seconds = max(watcher.kills, key=lambda one: one[1])
    print(f"{len(watcher.kills)} kills; after the slowest restart ({slowest}) the page was right in {seconds:.1f} s")
    print(f"the page's server had {watcher.bytes_max / 2**20:.0f} MiB at most")
    for line in wrong:
        print(f"WRONG: {line}")
    return 1 if wrong else 0


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness.soaks.watched", description=__doc__)
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="the time for which parts are killed, each at least once"
    )
    parser.add_argument("--picture", type=Path, help="the file for a picture of the tab at the end")
    arguments = parser.parse_args()
    return asyncio.run(soak(arguments.minutes, arguments.picture))


if __name__ == "__main__":
    raise SystemExit(main())
