"""Gathers the pages of the documentation's site in out/site-pages, for `make docs`.

The pages keep their places, so their links to each other stay as they are. A link to another file of the repository
gets a copy of that file; a link to a folder becomes plain text, because a site shows no folders.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "out/site-pages"
PAGES = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "deploy/README.md")
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#\s:]+)(#[^)\s]*)?\)")
IMAGE = re.compile(r"!\[[^\]]*\]\(([^)\s:]+)\)")
# The public surface: the modules whose docstrings are the reference, by page.
HANDLES = (
    "connection channel subscription producer group group_channel cuts matches queue message presence watch "
    "sampler listener"
)
VALUES = "timeline model policy reading grouping queueing peering codecs recording balancing"
REFERENCE = {
    "blocking": ("The blocking client", "stampede_rt", "stampede_rt._sync", HANDLES),
    "await": ("The client with await", "stampede_rt.aio", "stampede_rt._async", HANDLES),
    "values": ("Values", "stampede_rt", "stampede_rt.values", VALUES),
    "errors": ("Errors", "stampede_rt", "stampede_rt", "errors"),
}


def page(path: Path) -> str:
    """The text of a page for the site. Copies the files that it links to."""
    text = path.read_text()

    def link(found: re.Match[str]) -> str:
        target = (path.parent / found[2]).resolve()
        if target.is_dir():
            return found[1]
        if target.is_file() and target.is_relative_to(ROOT):
            copy(target)
        if target == ROOT / "README.md":
            return found[0].replace("README.md", "index.md")
        return found[0]

    for image in IMAGE.findall(text):
        copy((path.parent / image).resolve())
    return LINK.sub(link, text)


def copy(file: Path) -> None:
    """Copy a file that is not a page to its place beside the pages."""
    place = OUT / file.relative_to(ROOT)
    if file.suffix != ".md" and not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, place)


def reference() -> None:
    """Write the pages of the API reference, which mkdocstrings fills."""
    (OUT / "api").mkdir(parents=True)
    for name, (title, public, package, modules) in REFERENCE.items():
        entries = "\n".join(f"::: {package}.{module}\n" for module in modules.split())
        (OUT / f"api/{name}.md").write_text(
            f"# {title}\n\nThis page shows the public names of `{public}`.\n\n{entries}"
        )


def main() -> int:
    """Gather all pages. Returns the exit code."""
    shutil.rmtree(OUT, ignore_errors=True)
    reference()
    for path in [*(ROOT / name for name in PAGES), *sorted((ROOT / "docs").rglob("*.md"))]:
        place = OUT / ("index.md" if path == ROOT / "README.md" else path.relative_to(ROOT))
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(page(path))
    return 0


if __name__ == "__main__":
    sys.exit(main())
