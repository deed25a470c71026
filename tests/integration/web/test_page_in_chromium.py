"""The page in headless Chromium: the things that a person sees and does."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster
from tests.support.live_page import LivePage, eventually, live_page

np = pytest.importorskip("numpy")
if find_spec("playwright") is None:
    pytest.skip("Playwright is not installed: the page is not tested", allow_module_level=True)
CHROMIUM = shutil.which("chromium")
if CHROMIUM is None:
    pytest.skip("Chromium is not installed: the page is not tested", allow_module_level=True)

from stampede_rt_web.png import png_of  # noqa: E402  # after the skips

WAIT_MILLIS = 60_000
SCRIPT = "<img src=x onerror=\"window.ran='payload'\"><script>window.ran='payload'</script>"
TRICKY = "\x1b[31mred\u202eexe.txt\r\nsecond\tline\0"
TAPED = 10
HALF_SECOND = 500_000_000


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    with running_cluster(hosts=1, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        yield running


@pytest.fixture(scope="module")
def items(cluster: LocalCluster) -> Iterator[dict[str, st.Item]]:
    """Some channels with one or two items each, a group, and payloads that contain markup."""
    with st.connect(cluster.address) as rt:
        camera = rt.channel("cam/left", max_age="1h", content_type="image/png")
        number = rt.channel("imu", max_age="1h", codec="json")
        evil = rt.channel("evil", max_age="1h", content_type="text/html")
        rt.channel("constructor", max_age="1h").put(b"a name that every object of JavaScript has")
        rt.group("rig", [camera, number])
        first = number.put({"x": 1.0, "label": SCRIPT})
        picture = camera.put(png_of(np.zeros((8, 8, 3), dtype=np.uint8)) or b"", attributes={"lens": SCRIPT})
        second = number.put({"x": 2.0, "label": "later"})
        evil.put(SCRIPT.encode())
        tricky = rt.channel("tricky", max_age="1h", content_type="text/plain")
        tricky.put(TRICKY.encode(), attributes={"file": "a\u202eb\u200bc"})
        tape, began = rt.channel("tape", max_items=3, archive="forever"), st.now() - 7200 * 10**9
        for taped in range(TAPED):
            tape.put(f"taped {taped}".encode(), time=began + taped * HALF_SECOND)
        eventually(lambda: tape.stats().held == 3)
        yield {"first": first, "second": second, "picture": picture}


@pytest.fixture(scope="module")
def page_server(cluster: LocalCluster, items: dict[str, st.Item]) -> Iterator[LivePage]:
    with live_page(cluster.address) as running:
        yield running


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright  # not at the top: it takes 0.2 s to load

    with sync_playwright() as started:
        found = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])  # CI runs as root
        yield found
        found.close()


class Tab:
    """A tab of the browser, and everything that went wrong in it."""

    def __init__(self, context: Any) -> None:
        self.page = context.new_page()
        self.page.set_default_timeout(WAIT_MILLIS)
        self.troubles: list[str] = []
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on("console", lambda message: self.troubles.append(message.text) if message.type == "error" else None)

    def show(self, url: str) -> None:
        self.page.goto(url)
        self.page.wait_for_selector(".row")
        self.page.wait_for_selector(".card img")


@pytest.fixture
def tab(browser: Any, page_server: LivePage) -> Iterator[Tab]:
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    made = Tab(context)
    made.show(page_server.url)
    yield made
    context.close()
    assert made.troubles == []


def test_the_page_shows_each_channel_and_its_newest_item(tab: Tab) -> None:
    assert tab.page.locator(".row h3").all_inner_texts() == ["cam/left", "constructor", "evil", "imu", "tape", "tricky"]
    tab.page.wait_for_function("document.querySelector('.card img').naturalWidth === 8")
    tab.page.wait_for_selector("text=x 2")
    assert tab.page.locator("#trouble").is_hidden()
    assert "rig" in tab.page.locator("#state").inner_text()


def test_names_attributes_and_payloads_stay_text(tab: Tab) -> None:
    tab.page.wait_for_selector("article[aria-label=evil] pre")
    assert SCRIPT in tab.page.locator("article[aria-label=evil] pre").inner_text()
    assert SCRIPT in tab.page.locator("article[aria-label='cam/left'] dl").inner_text()
    assert tab.page.evaluate("window.ran") is None


def test_control_characters_and_marks_of_direction_are_shown_as_escapes(tab: Tab) -> None:
    shown = tab.page.wait_for_selector("article[aria-label=tricky] pre")
    assert shown.text_content() == r"\u{1b}[31mred\u{202e}exe.txt" + "\n" + "second\tline" + r"\u{0}"
    assert r"a\u{202e}b\u{200b}c" in tab.page.locator("article[aria-label=tricky] dl").inner_text()
    findings = [{"part": "host\u202e", "address": "[::1]:1", "state": "lost\x1b", "advice": "a\u2028b"}]
    tab.page.route("**/api/doctor*", lambda route: route.fulfill(json={"findings": findings}))
    tab.page.reload()
    tab.page.wait_for_selector(r"td >> text=host\u{202e} [::1]:1")
    tab.page.wait_for_selector(r"td >> text=a\u{2028}b")


def test_the_arrow_keys_still_step_after_a_press_of_a_button(tab: Tab, items: dict[str, st.Item]) -> None:
    page = tab.page
    page.locator(".row h3", has_text="imu").click()
    page.focus("#live")
    page.keyboard.press("Space")
    page.wait_for_selector("#live[aria-pressed=false]")
    page.keyboard.press("ArrowLeft")
    shown = f"{items['second'].time % 1_000_000_000:09d}"[:6]
    page.wait_for_function("text => document.querySelector('#instant').textContent.endsWith(text)", arg=shown)
    page.keyboard.press("Space")
    page.wait_for_selector("#live[aria-pressed=true]")


def test_keys_stop_the_page_at_an_instant_and_step_from_item_to_item(tab: Tab, items: dict[str, st.Item]) -> None:
    page = tab.page
    page.locator(".row h3", has_text="imu").click()
    page.keyboard.press(" ")
    assert page.locator("#live").get_attribute("aria-pressed") == "false"
    for expected in (items["second"], items["first"]):
        shown = f"{expected.time % 1_000_000_000:09d}"[:6]
        page.keyboard.press("ArrowLeft")
        page.wait_for_function("text => document.querySelector('#instant').textContent.endsWith(text)", arg=shown)
    page.wait_for_selector("article[aria-label='cam/left'].none")  # no picture yet at the time of the first number
    page.keyboard.press(" ")
    page.wait_for_selector("article[aria-label='cam/left'] img")


def test_a_click_on_the_time_line_shows_the_items_of_every_channel_at_that_time(tab: Tab) -> None:
    tab.page.select_option("#window", "600")
    tab.page.locator(".row canvas").first.click(position={"x": 3, "y": 10})
    tab.page.wait_for_selector("article[aria-label='cam/left'].none")
    assert tab.page.locator("#live").get_attribute("aria-pressed") == "false"


def test_home_moves_to_the_oldest_item_of_the_archive_and_the_row_shows_the_reach_of_the_archive(tab: Tab) -> None:
    page = tab.page
    page.locator(".row h3", has_text="tape").click()
    page.keyboard.press("Home")
    page.wait_for_selector("article[aria-label=tape] >> text=taped 0")
    page.wait_for_selector(r"text=/archive 2\.0\d h/")
    first, memory, edge = page.wait_for_function(ARCHIVE_LINE).json_value()
    assert first == pytest.approx(0.5, abs=0.02)  # the chosen instant is in the middle of the window of 10 s
    assert edge == pytest.approx(0.5 + (TAPED - 3) * 0.05, abs=0.02)
    assert memory == "Memory begins here"


# Where the violet line begins and ends, as parts of the row, and the text of the page at the line's end.
ARCHIVE_LINE = """() => {
  const row = [...document.querySelectorAll(".row")].find((one) => one.querySelector("h3").textContent === "tape");
  const canvas = row.querySelector("canvas");
  const y = Math.round(canvas.height - 2 * devicePixelRatio - 1);
  const pixels = canvas.getContext("2d").getImageData(0, y, canvas.width, 1).data;
  const paint = document.createElement("canvas").getContext("2d");
  paint.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--archive").trim();
  paint.fillRect(0, 0, 1, 1);
  const wanted = paint.getImageData(0, 0, 1, 1).data;
  const found = [];
  const isLine = (x) => [0, 1, 2].every((at) => Math.abs(pixels[4 * x + at] - wanted[at]) < 3);
  for (let x = 0; x < canvas.width; x++) if (isLine(x)) found.push(x);
  if (!found.length) return null;
  const box = canvas.getBoundingClientRect();
  const end = found.at(-1) / canvas.width;
  canvas.dispatchEvent(new MouseEvent("mousemove", { clientX: box.left + end * box.width, clientY: box.top + 5 }));
  return [found[0] / canvas.width, canvas.title.split(":")[0], end];
}"""


def test_a_page_of_a_group_hides_the_items_that_the_group_hides(tab: Tab) -> None:
    tab.page.select_option("#group", "rig")
    tab.page.wait_for_selector("article[aria-label=imu] >> text=x 1")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1280])
def test_the_page_fits_and_is_readable_in_both_themes(
    browser: Any, page_server: LivePage, scheme: str, width: int
) -> None:
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme)
    tab = Tab(context)
    tab.show(page_server.url)
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.page.evaluate(CONTRAST) >= 4.5
    heights = [tab.page.locator(name).bounding_box()["y"] for name in ("#theme", "#help")]
    assert heights[0] == heights[1]
    context.close()
    assert tab.troubles == []


@pytest.mark.parametrize("width", [400, 1280])
def test_no_panel_breaks_a_word_of_the_doctors_findings(browser: Any, page_server: LivePage, width: int) -> None:
    context = browser.new_context(viewport={"width": width, "height": 800})
    advice = "start it again, or remove it with `stampede supernode remove s2`"
    findings = [{"part": "supernode", "address": "localhost:30000", "state": "unreachable", "advice": advice}]
    tab = Tab(context)
    tab.page.route("**/api/doctor*", lambda route: route.fulfill(json={"findings": findings}))
    tab.show(page_server.url)
    tab.page.wait_for_selector("td >> text=unreachable")
    assert tab.page.evaluate(BROKEN_WORDS) == []
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= width
    context.close()
    assert tab.troubles == []


# The words in the cells of all panels that are on more than one line.
BROKEN_WORDS = """() => [...document.querySelectorAll(".panel td, .panel th")].flatMap((cell) => {
  const walker = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT);
  const broken = [];
  while (walker.nextNode()) {
    for (const word of walker.currentNode.data.matchAll(/\\S+/g)) {
      const range = document.createRange();
      range.setStart(walker.currentNode, word.index);
      range.setEnd(walker.currentNode, word.index + word[0].length);
      if (new Set([...range.getClientRects()].map((box) => Math.round(box.top))).size > 1) broken.push(word[0]);
    }
  }
  return broken;
})"""


# The least contrast of the shown texts with the page's background, as WCAG computes it.
CONTRAST = """() => {
  const light = (text) => {
    const [r, g, b] = text.match(/[\\d.]+/g).slice(0, 3).map((one) => {
      const part = one / 255;
      return part <= 0.03928 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const paper = light(getComputedStyle(document.body).backgroundColor);
  const shown = [...document.querySelectorAll("h1, h2, h3, small, dt, dd, td, th, .dim")];
  return Math.min(...shown.map((one) => {
    const ink = light(getComputedStyle(one).color);
    return (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05);
  }));
}"""
