"""Which errors do the tests notice? Put them into a copy of the package, one at a time.

The errors are listed in `mutants.toml`. For each of them the tests mapped to its file run first,
then the whole default suite; both stop at the first failure. The checkout is never changed. One
line per error goes to a file of JSON lines, and errors with a line there are not run again.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "dolfinx_signorini"
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info")
Mutant = dict[str, str]


def changed(mutant: Mutant, text: str) -> str:
    """Return the text of a file with its error.

    Raises:
        SystemExit: The old text is not there exactly once, or the new text is no Python.
    """
    count = text.count(mutant["old"])
    if count != 1 or mutant["old"] == mutant["new"]:
        sys.exit(f"{mutant['file']}: found {count} times, not once:\n{mutant['old']}")
    result = text.replace(mutant["old"], mutant["new"])
    try:
        compile(result, mutant["file"], "exec")
    except SyntaxError as error:
        sys.exit(f"{mutant['file']}: {error}:\n{mutant['new']}")
    return result


def key(mutant: Mutant) -> str:
    """Return a digest that tells errors apart."""
    return hashlib.sha256(repr(sorted(mutant.items())).encode()).hexdigest()[:16]


def mapped(tests: dict[str, list[str]], file: str) -> list[str]:
    """Return the tests of a file: those of the longest path in the mapping that leads to it."""
    fitting = [path for path in tests if file == path or file.startswith(path + "/")]
    return tests[max(fitting, key=len)] if fitting else []


def run_tests(copy: Path, tests: Sequence[str], limit: float) -> str:
    """Return the first test that fails in a copy of the checkout, or "".

    Args:
        copy: The copy.
        tests: Files of tests; none for the default suite.
        limit: The seconds after which an endless loop is taken for a failure.
    """
    options = ["-x", "-q", "-rfE", "--tb=no", "-p", "no:cacheprovider", "--complete"]
    # Two errors of the same size in the same second look alike to a cache of compiled files.
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", *options, *tests],
        cwd=copy,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:
        output, _ = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        return f"nothing after {limit:g} s"
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if process.returncode == 0:
        return ""
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return found[1] if found else f"pytest ended with {process.returncode}: {output[-300:]}"


def verdict(copy: Path, mutant: Mutant, first: Sequence[str], arguments: Any) -> dict[str, Any]:
    """Return what the tests say of an error in a copy of the checkout."""
    path = copy / PACKAGE / mutant["file"]
    original, began = path.read_text(), time.perf_counter()
    path.write_text(changed(mutant, original))
    try:
        caught = run_tests(copy, first, arguments.limit) if first else ""
        if not caught and not arguments.mapped_only:
            caught = run_tests(copy, [], arguments.limit)
    finally:
        path.write_text(original)
    seconds = round(time.perf_counter() - began, 1)
    line = {"key": key(mutant), "caught": bool(caught), "by": caught, "seconds": seconds}
    return line | {name: mutant[name] for name in ("file", "breaks")}


def known(results: Path) -> dict[str, dict[str, Any]]:
    """Return the results so far; of several lines about one error the last counts."""
    lines = results.read_text().splitlines() if results.exists() else []
    return {line["key"]: line for line in map(json.loads, lines)}


def selected(mutants: list[Mutant], arguments: Any) -> Iterator[Mutant]:
    """Yield the errors that are to be run."""
    done = known(arguments.results)
    for mutant in mutants:
        result = done.get(key(mutant))
        words = f"{mutant['file']} {mutant['breaks']}"
        again = arguments.survivors and result is not None and not result["caught"]
        if (result is None or again) and arguments.only in words:
            yield mutant


def summary(mutants: list[Mutant], results: Path) -> str:
    """Return the counts, and the errors that no test noticed."""
    done = [known(results).get(key(mutant)) for mutant in mutants]
    lines = [line for line in done if line is not None]
    survivors = [f"  {line['file']}: {line['breaks']}" for line in lines if not line["caught"]]
    caught = len(lines) - len(survivors)
    head = f"{len(mutants)} errors, {len(lines)} run, {caught} caught, {len(survivors)} survived"
    return "\n".join([head, *survivors])


def main() -> None:
    """Run the errors that have no result yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    add = parser.add_argument
    add("--results", type=Path, default=Path("mutants.jsonl"), help="the file of JSON lines")
    add("--only", default="", metavar="TEXT", help="errors with this text in file or description")
    add("--survivors", action="store_true", help="also those that survived the last time")
    add("--mapped-only", action="store_true", help="leave the whole suite out")
    add("--check", action="store_true", help="only see whether the list fits the package")
    add("--limit", type=float, default=900.0, help="seconds that one run of tests may take")
    arguments = parser.parse_args()
    listed = tomllib.loads((ROOT / "mutants" / "mutants.toml").read_text())
    mutants, tests = listed["mutant"], listed["tests"]
    for mutant in mutants:
        changed(mutant, (ROOT / PACKAGE / mutant["file"]).read_text())
    chosen = [] if arguments.check else list(selected(mutants, arguments))
    if chosen:
        with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
            copy = Path(folder) / "copy"
            shutil.copytree(ROOT, copy, ignore=LEFT_OUT)
            first = sorted({test for m in chosen for test in mapped(tests, m["file"])})
            failing = run_tests(copy, first if arguments.mapped_only else [], arguments.limit)
            if failing:
                sys.exit(f"without any error in the package this fails already: {failing}")
            for mutant in chosen:
                line = verdict(copy, mutant, mapped(tests, mutant["file"]), arguments)
                with arguments.results.open("a") as file:
                    file.write(json.dumps(line) + "\n")
                print(
                    f"{line['by'] or 'SURVIVED':<60} {line['file']}: {line['breaks']}", flush=True
                )
    print(summary(mutants, arguments.results))


if __name__ == "__main__":
    main()
