"""Linear systems in which some dofs are held: factorizations, multigrid, and their options."""
