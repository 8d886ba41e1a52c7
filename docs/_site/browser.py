"""Look at a built site in headless Chromium: missing pictures, pages wider than the screen.

Run: python3 docs/_site/browser.py build/site [FOLDER for screenshots]

Needs nothing but Python and the program chromium; the site is served on this machine's own address.
"""

import html
import json
import re
import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

WIDTHS = 1280, 390
CHECK = "__check__.html"
BUDGET = 240_000  # milliseconds of virtual time
SHOTS = (
    "index.html",
    "tutorials/first_contact.html",
    "gallery/index.html",
    "reference/api.html",
    "explanation/cascade.html",
    "howto/recipes.html",
)
PAGE = """<!doctype html><title>check</title><pre id="found">running</pre><script>
const pages = PAGES, widths = WIDTHS, found = [];
const look = (page, width) => new Promise(done => {
  const frame = document.createElement("iframe");
  frame.style.width = width + "px"; frame.style.height = "900px";
  frame.onload = () => setTimeout(() => {
    const d = frame.contentDocument, root = d.documentElement;
    for (const image of d.images) image.loading = "eager";
    if (root.scrollWidth > width + 1)
      found.push(`${page} at ${width}: ${root.scrollWidth} pixels wide`);
    for (const image of d.images)
      if (image.complete && !image.naturalWidth) found.push(`${page}: no picture ${image.src}`);
    if (!d.querySelector("h1")) found.push(`${page}: no heading`);
    frame.remove(); done();
  }, 100);
  frame.src = page; document.body.append(frame);
});
(async () => {
  for (const width of widths) for (const page of pages) await look(page, width);
  document.getElementById("found").textContent = JSON.stringify([...new Set(found)]);
})();
</script>"""


class _Handler(SimpleHTTPRequestHandler):
    """Serves the site, and is silent about it."""

    def log_message(self, *args: object) -> None:
        pass


def chromium(*arguments: str) -> str:
    """Run headless Chromium, and return what it prints.

    Args:
        arguments: Its arguments.
    """
    command = ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    done = subprocess.run(
        [*command, *arguments], capture_output=True, text=True, timeout=300, check=True
    )
    return done.stdout


def problems(site: Path, address: str) -> list[str]:
    """Return what is wrong with the layout of the pages.

    Args:
        site: The folder with the pages.
        address: Where the site is served.
    """
    pages = sorted(str(path.relative_to(site)) for path in site.rglob("*.html"))
    pages = [
        page for page in pages if not page.startswith("_") and page not in (CHECK, "search.html")
    ]
    check = PAGE.replace("PAGES", json.dumps(pages)).replace("WIDTHS", json.dumps(WIDTHS))
    (site / CHECK).write_text(check)
    try:
        dom = chromium(f"--virtual-time-budget={BUDGET}", "--dump-dom", f"{address}/{CHECK}")
    finally:
        (site / CHECK).unlink()
    match = re.search(r'<pre id="found">(.*?)</pre>', dom, re.DOTALL)
    text = html.unescape(match[1]) if match else ""
    if not text.startswith("["):
        return [f"the pages could not be looked at: {text}"]
    return list(json.loads(text))


def main(site: Path, shots: Path | None) -> int:
    """Check a site, and take pictures of some pages.

    Args:
        site: The folder with the pages.
        shots: Where the pictures go; None for none.
    """
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = f"http://127.0.0.1:{server.server_port}"
    found = problems(site, address)
    for page in SHOTS if shots else ():
        for width in WIDTHS:
            name = f"{page.removesuffix('.html').replace('/', '-')}-{width}.png"
            size = f"--window-size={width},1600"
            chromium(size, f"--screenshot={shots / name}", f"{address}/{page}")
    server.shutdown()
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{len(found)} problems of layout in Chromium at {WIDTHS} pixels")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None))
