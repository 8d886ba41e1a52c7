"""Do the conda files parse, and do they ask for what the package asks for?

    pip install py-rattler py-rattler-build pyyaml
    python packaging/conda/check.py

The recipe is read and rendered by rattler-build, which refuses what its schema does not have, and
each dependency of the recipe and of both environments is parsed strictly. conda is not needed.
"""

import sys
import tomllib
from pathlib import Path
from typing import Any

import rattler_build
import yaml
from rattler import MatchSpec

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENTS = "environment.yml", "docs/environment.yml"
# What conda calls otherwise than PyPI.
CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def rendered_recipe() -> dict[str, Any]:
    """Return the recipe with its variables replaced.

    Raises:
        rattler_build.RattlerBuildError: The recipe does not fit the schema.
    """
    recipe = rattler_build.Stage0Recipe.from_file(Path(__file__).with_name("recipe.yaml"))
    (variant,) = recipe.render(rattler_build.VariantConfig())
    found: dict[str, Any] = variant.recipe.to_dict()
    return found


def names(specs: list[Any], where: str) -> dict[str, str]:
    """Return dependencies by name, each parsed strictly.

    Args:
        specs: The dependencies, as conda writes them; a list of pip's is left out.
        where: Whose dependencies they are, for messages.
    """
    found = {}
    for spec in specs:
        if isinstance(spec, str):
            try:
                found[MatchSpec(spec, strict=True).name.normalized] = spec
            except Exception as error:
                sys.exit(f"{where}: {spec!r}: {error}")
    return found


def differences() -> list[str]:
    """Return what the conda files lack, a line each."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe, lines = rendered_recipe(), []
    needed = {}
    for dependency in map(MatchSpec, project["dependencies"]):
        name = dependency.name.normalized
        needed[CONDA_NAMES.get(name, name)] = dependency.version
    run = names(recipe["requirements"]["run"], "recipe.yaml")
    names(recipe["requirements"]["host"] + recipe["requirements"]["run_constraints"], "recipe.yaml")
    if recipe["package"]["version"] != project["version"]:
        lines.append(f"recipe.yaml: version {recipe['package']['version']}")
    entry_points = [f"{name} = {place}" for name, place in project["scripts"].items()]
    if recipe["build"]["python"]["entry_points"] != entry_points:
        lines.append("recipe.yaml: other entry points than pyproject.toml")
    found = {"recipe.yaml": run}
    for environment in ENVIRONMENTS:
        content = yaml.safe_load((ROOT / environment).read_text())
        found[environment] = names(content["dependencies"], environment)
    needed["python"] = MatchSpec("python " + project["requires-python"]).version
    for where, specs in found.items():
        lines += [f"{where}: no {name}" for name in sorted((needed.keys() | ADDED) - specs.keys())]
        lines += [
            f"{where}: {specs[name]}, not {name} {version or 'of any version'}"
            for name, version in needed.items()
            if name in specs and MatchSpec(specs[name]).version != version
        ]
    return lines


# dolfinx and what comes with it are not on PyPI, so pyproject.toml does not name them.
ADDED = {"fenics-dolfinx", "petsc", "slepc4py"}

if __name__ == "__main__":
    faults = differences()
    print("\n".join(faults) or "the recipe and both environments are in order")
    sys.exit(bool(faults))
