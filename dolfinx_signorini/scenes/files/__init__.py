"""Scene files: tables, keys, overrides and boundary conditions."""
