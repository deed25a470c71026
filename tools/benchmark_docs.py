"""Put reports of `stampede bench` into docs/benchmarks.md, between their markers, and their charts into docs/images.

`python tools/benchmark_docs.py FOLDER` takes `paper.txt`, `growth.md`, `limits.md` and `peers.md`, if they are in the
folder.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent.parent / "docs"
PAGE = DOCS / "benchmarks.md"
BEGIN, END = "<!-- {}: filled by `make bench-docs` -->\n", "<!-- /{} -->"
PAPER_CHARTS = ("get", "interval", "contention", "proxies", "proxies-cpu", "visibility", "skew", "memory")


def filled(page: str, name: str, report: str, charts: list[str]) -> str:
    """Return the page with that report and its charts between the markers of `name`.

    Raises ValueError if the page lacks the markers.
    """
    before, begin, rest = page.partition(BEGIN.format(name))
    _, end, after = rest.partition(END.format(name))
    if not begin or not end:
        raise ValueError(f"{PAGE.name} has no markers for {name}: {BEGIN.format(name).strip()} and {END.format(name)}")
    images = "".join(f"![{Path(chart).stem}](images/bench-{chart})\n" for chart in charts)
    return f"{before}{begin}{report.strip()}\n\n{images}{end}{after}"


def report_of(folder: Path, name: str) -> str | None:
    """Return the report of that name as Markdown, without its title; None if the folder has no such report."""
    file = folder / (f"{name}.txt" if name == "paper" else f"{name}.md")
    if not file.exists():
        return None
    text = file.read_text()
    if name == "paper":
        return f"```\n{text.strip()}\n```"
    return text.partition("\n")[2]


def charts_of(folder: Path, name: str) -> list[str]:
    """Return the file names of the charts of that report."""
    if name == "paper":
        return [f"{chart}.png" for chart in PAPER_CHARTS if (folder / f"{chart}.png").exists()]
    return sorted(path.name for path in folder.glob(f"{name}-*.png"))


def main() -> int:
    """Fill the page. Returns 0, or 2 if the folder has no report."""
    folder, page, found = Path(sys.argv[1]), PAGE.read_text(), False
    for name in ("paper", "growth", "limits", "peers"):
        report = report_of(folder, name)
        if report is None:
            print(f"{name}: no report in {folder}; its section stays as it is")
            continue
        found = True
        charts = charts_of(folder, name)
        page = filled(page, name, report, charts)
        for chart in charts:
            shutil.copyfile(folder / chart, DOCS / "images" / f"bench-{chart}")
    PAGE.write_text(page)
    return 0 if found else 2


if __name__ == "__main__":
    sys.exit(main())
