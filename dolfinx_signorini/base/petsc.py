"""Objects of PETSc."""

from typing import Any


def destroy(*items: Any) -> None:
    """Free objects of PETSc, and others that have such; None stands for none."""
    for item in items:
        if item is not None:
            item.destroy()
