"""The solvers: residual, TAO, the active set method, patches, and the cascade over levels."""

from dolfinx_signorini.solvers.cascade import METHODS

__all__ = ["METHODS"]
