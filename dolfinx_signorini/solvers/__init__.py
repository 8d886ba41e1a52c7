"""The solvers: residual, TAO, the active set method, patches, and the cascade over levels."""
