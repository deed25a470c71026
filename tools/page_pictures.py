"""Takes the pictures of docs/live-page.md: `.venv/bin/python tools/page_pictures.py [FOLDER]`.

It starts a cluster with cameras, an IMU, captions and a recorded channel, and opens the live page in Debian's chromium.
Without FOLDER it replaces the pictures in docs/images.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, sync_playwright

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from stampede_rt_web.png import png_of

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
READY_SECONDS, WARM_UP_SECONDS, SETTLE_MILLIS = 60.0, 14.0, 2500
TICK_SECONDS, SECOND = 0.1, 10**9
HEIGHT, WIDTH, NARROW = 800, 1280, 400
LATE_TURN, CAPTION_TURNS, DEPTH_TURNS = 60, 20, 3
DEPTH_LATE_TURNS, DEPTH_LATE_NANOS = 40, 4 * SECOND  # depth comes late, so the group hides the newest pictures
YY, XX = np.mgrid[0:120, 0:160]


def camera(turn: int, shift: int) -> bytes:
    """A picture in which a disc moves. `shift` moves the disc, as in the other camera of a stereo pair."""
    picture = np.zeros((*XX.shape, 3), dtype=np.uint8)
    picture[..., 0], picture[..., 1], picture[..., 2] = XX + 40, YY * 2, 140
    disc = (XX - 80 - shift - 45 * math.sin(turn / 9)) ** 2 + (YY - 60 - 20 * math.cos(turn / 9)) ** 2
    picture[disc < 300] = 255
    return png_of(picture) or b""


def depth(turn: int) -> Any:
    """The distances in metres."""
    distance = np.hypot(XX - 80 - 45 * math.sin(turn / 9), YY - 60 - 20 * math.cos(turn / 9))
    return (0.5 + distance / 40).astype(np.float32)


class Scene:
    """The channels of the pictures, and the items of each tenth of a second."""

    def __init__(self, rt: st.Connection) -> None:
        self.left = rt.channel("cam/left", max_age="1m", content_type="image/png")
        self.right = rt.channel("cam/right", max_age="1m", content_type="image/png")
        self.depth = rt.channel("cam/depth", max_age="1m", codec="numpy")
        self.imu = rt.channel("imu", max_age="5s", archive="7d", codec="json")
        self.captions = rt.channel("captions", max_age="10m", content_type="text/plain")
        self.events = rt.channel("events", max_age="10m", codec="json")
        rt.group("rig", [self.left, self.right, self.depth])
        rt.queue("jobs").put(b"find the disc")

    def play(self, turn: int) -> None:
        """Put the items of one turn."""
        now = st.now()
        for channel, shift in ((self.left, 0), (self.right, 8)):
            channel.put(camera(turn, shift), time=now, duration="90ms", attributes={"exposure": "4 ms"})
        if turn % DEPTH_TURNS == 0:
            self.depth.put(depth(turn - DEPTH_LATE_TURNS), time=now - DEPTH_LATE_NANOS, duration="90ms")
        delay = SECOND if turn % LATE_TURN == LATE_TURN // 2 else 0
        self.imu.put({"yaw": math.sin(turn / 9), "pitch": 0.3 * math.cos(turn / 5)}, time=now - delay)
        if turn % CAPTION_TURNS == 0:
            self.captions.put(f"caption {turn // CAPTION_TURNS}".encode(), time=now, duration="1500ms")
        if turn % LATE_TURN == 0:
            self.events.put({"event": "turned", "side": "left"}, time=now)


def feed(address: str, ended: threading.Event) -> None:
    """Play the scene until `ended`."""
    with st.connect(address) as rt:
        scene, turn = Scene(rt), 0
        while not ended.wait(TICK_SECONDS):
            scene.play(turn)
            turn += 1


def shoot(browser: Browser, url: str, folder: Path, *, scheme: str, width: int, at_instant: bool) -> None:
    """Take one picture of the page: live, or at an instant through the group."""
    context = browser.new_context(viewport={"width": width, "height": HEIGHT}, color_scheme=scheme)
    page = context.new_page()
    page.goto(url)
    page.wait_for_selector(".card img")
    if at_instant:
        page.select_option("#group", "rig")
        page.locator(".row canvas").first.click(
            position={"x": 0.45 * (width - 310 if width > NARROW else width), "y": 10}
        )
    page.wait_for_timeout(SETTLE_MILLIS)
    name = f"live-page-{scheme}{'-narrow' if width == NARROW else ''}.png"
    page.screenshot(path=folder / name, full_page=width != NARROW)
    context.close()


def main() -> int:
    """Take all pictures. Returns the exit code."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    with ExitStack() as stack:
        cluster = stack.enter_context(LocalCluster(hosts=2, supernodes=1, archive=folder / "archive"))
        stack.callback(shutil.rmtree, folder / "archive", ignore_errors=True)
        os.environ["STAMPEDE_SECRET_FILE"] = secret = str(cluster.secret_file)
        words = ["--listen", "localhost:0", "--url", cluster.address, "--secret-file", secret]
        server = ServiceProcess("the page", "stampede_rt_web", words)
        stack.callback(server.stop)
        server.start()
        url = server.wait_ready(READY_SECONDS)
        ended = threading.Event()
        feeding = threading.Thread(target=feed, args=(cluster.address, ended))
        stack.callback(feeding.join)
        stack.callback(ended.set)
        feeding.start()
        ended.wait(WARM_UP_SECONDS)
        chromium = stack.enter_context(sync_playwright()).chromium
        browser = chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        for scheme in ("light", "dark"):
            for width in (WIDTH, NARROW):
                shoot(browser, url, folder, scheme=scheme, width=width, at_instant=scheme == "dark")
        browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
