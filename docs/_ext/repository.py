"""Files of the repository that are pages of the site too, and links to them.

Their links are written for a reader of the repository, so they lead from page to page here.
"""

import re
from os.path import normpath, relpath
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = {
    "ARCHITECTURE.md": "docs/project/architecture.md",
    "CONTRIBUTING.md": "docs/project/contributing.md",
    "CHANGELOG.md": "docs/project/changelog.md",
    "firmware/README.md": "docs/project/firmware.md",
}
LINK = re.compile(r"(?<=\]\()(?!\w+:|#|/)([^)#\s]+)")


def write_pages() -> None:
    """Write the files of the repository that are pages of the site."""
    for source, page in PAGES.items():
        text = with_links((ROOT / source).read_text(encoding="utf-8"), source, page)
        path = ROOT / page
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def with_links(text: str, source: str, page: str) -> str:
    """Return a text whose links, relative to its source, are relative to its page."""

    def moved(link: re.Match[str]) -> str:
        target = normpath(Path(source).parent / link[1])
        return relpath(PAGES.get(target, target), Path(page).parent)

    return LINK.sub(moved, text)


def read(app, docname: str, content: list[str]) -> None:
    page = f"docs/{docname}.md"
    if page not in PAGES.values():
        content[0] = with_links(content[0], page, page)


def setup(app):
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
