"""The solvers: residual, TAO, the active set method, patches, and the cascade over levels."""

from dolfinx_signorini.solvers.tao import METHODS as TAO_METHODS

METHODS = ("cascade", *TAO_METHODS)
