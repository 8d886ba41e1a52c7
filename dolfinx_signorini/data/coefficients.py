"""The coefficients and the load of -div(A grad u) + c u = f as formulas."""

from dataclasses import dataclass

from dolfinx_signorini.data.formulas import Formula


@dataclass(frozen=True)
class Coefficients:
    """What is known of an equation in the domain:

        Coefficients(load=parse("sin(pi*x)"), reaction=None, diffusion=())

    Attributes:
        load: f; None for 0.
        reaction: c; None for 0.
        diffusion: The rows of A; one entry stands for a multiple of the identity, none for 1.
    """

    load: Formula | None
    reaction: Formula | None
    diffusion: tuple[tuple[Formula, ...], ...]

    @property
    def entries(self) -> tuple[Formula, ...]:
        """The entries of A."""
        return tuple(entry for row in self.diffusion for entry in row)
