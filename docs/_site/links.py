"""Check a built site: every link, picture and anchor within it is there.

Run: python3 docs/_site/links.py build/site
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag, urlparse

ATTRIBUTES = {"a": "href", "img": "src", "link": "href", "script": "src", "source": "src"}


class _Page(HTMLParser):
    """The links and the anchors of a page."""

    def __init__(self, text: str):
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        for key in ("id", "name"):
            if found.get(key):
                self.anchors.add(str(found[key]))
        link = found.get(ATTRIBUTES.get(tag, ""))
        if link:
            self.links.append(link)


def broken(site: Path) -> list[str]:
    """Return what is wrong, one text for each broken link.

    Args:
        site: The folder with the pages.
    """
    pages = {path.resolve(): _Page(path.read_text()) for path in site.rglob("*.html")}
    wrong = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlparse(link)
            if parts.scheme or parts.netloc:
                if parts.scheme == "file":
                    wrong.append(f"{path.relative_to(site.resolve())}: {link}")
                continue
            target, anchor = urldefrag(link)
            place = (path.parent / unquote(target.split("?")[0])).resolve() if target else path
            if place.is_dir():
                place /= "index.html"
            known = pages[place].anchors if place in pages else set()
            if not place.exists() or (anchor and place in pages and unquote(anchor) not in known):
                wrong.append(f"{path.relative_to(site.resolve())}: {link}")
    return sorted(set(wrong))


if __name__ == "__main__":
    found = broken(Path(sys.argv[1]))
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{len(found)} broken links in {len(list(Path(sys.argv[1]).rglob('*.html')))} pages")
    sys.exit(bool(found))
