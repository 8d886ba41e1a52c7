"""Scene files: tables, keys, overrides, boundary conditions and obstacles in the domain."""
