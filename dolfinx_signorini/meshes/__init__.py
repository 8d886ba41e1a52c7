"""Meshes with named sides, their refinement, elements, quadrature rules and points."""
