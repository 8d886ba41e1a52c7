"""The gallery: every scene file of demos/scenes, solved, with its pictures and numbers."""

import contextlib
import io
import json
import shutil
from pathlib import Path

import numpy as np

from dolfinx_signorini.commands import main as cli
from dolfinx_signorini.scenes.output.summary import force_text

ORDER = (
    "obstacle",
    "membrane",
    "awning",
    "torsion",
    "osmosis",
    "thermostat",
    "plate",
    "paper",
    "mixed",
    "polygon",
    "lshape",
    "layers",
    "cube",
    "half_sphere",
    "hertz",
    "punch",
    "beam",
    "ring",
    "ball",
)
CELLS = {"cube": 10, "half_sphere": 10}  # smaller than in the file, for the pictures
HEAD = """# Gallery

Each scene is one file of `demos/scenes`, solved when this page was built. Take the nearest one,
change what is different, and run `dolfinx-signorini solve` on it.
"""
ENTRY = """
## {title}

{story}

::::{{div}} gallery
![The solution: {title}]({name}-solution.png)

![Contact: {title}]({name}-contact.png)
::::

{numbers}

:::{{dropdown}} The scene file {name}.toml
```toml
{text}
```
:::
"""


def make_gallery(docs: Path) -> None:
    """Solve the scenes, and write the page with their pictures.

    Args:
        docs: The folder of the site.
    """
    folder, scenes = docs / "gallery", docs.parent / "demos" / "scenes"
    found = {path.stem: path for path in scenes.glob("*.toml")}
    names = [*ORDER, *sorted(found.keys() - set(ORDER))]
    page = HEAD
    for name in names:
        page += _entry(folder, found[name], CELLS.get(name))
    (folder / "index.md").write_text(page)


def _entry(folder: Path, path: Path, cells: int | None) -> str:
    """Return the part of a scene; solve it where file or program are newer than its pictures."""
    name, text = path.stem, path.read_text()
    results = folder / ".results" / name
    record = results / "record.json"
    sources = [path, *Path(cli.__file__).parents[1].rglob("*.py")]
    newest = max(source.stat().st_mtime for source in sources)
    if not record.exists() or record.stat().st_mtime < newest:
        results.mkdir(parents=True, exist_ok=True)
        arguments = ["solve", str(path), "--outputs", "pictures", "--out", str(results), "-q"]
        if cells is not None:
            arguments += ["--set", f"domain.cells={cells}"]
        with contextlib.redirect_stdout(io.StringIO()):
            code = cli.main(arguments)
        if code:
            raise RuntimeError(f"{path.name} ended with exit code {code}")
    for picture in ("solution", "contact"):
        shutil.copy(results / f"{picture}.png", folder / f"{name}-{picture}.png")
    data = json.loads(record.read_text())
    lines = text.splitlines()
    count = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    story = " ".join(line.lstrip("# ") for line in lines[:count])
    return ENTRY.format(
        title=data["title"],
        story=story,
        name=name,
        numbers=_numbers(data["summary"]),
        text="\n".join(lines[count:]).strip(),
    )


def _numbers(summary: dict) -> str:
    size = max(np.abs(force).max() for force in summary["forces"].values())
    parts = [
        f"{summary['unknowns']} unknowns",
        f"in contact on {summary['contact_size']:.3g} of {summary['boundary_size']:.3g}",
        f"force of contact {force_text(summary['forces']['contact'], size)}",
        *(f"{name} {value:.4g}" for name, value in summary["body"].items() if value),
        *(f"error {norm} {error:.1e}" for norm, error in summary["errors"].items()),
    ]
    return ", ".join(parts) + "."
