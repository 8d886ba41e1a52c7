"""Experiments with the solver: the paper's tables and theory, and speed against accuracy."""

# Residual of solutions whose digits count: the algebra leaves some ten times as much in an error
# (1e-6 with 1e-7), and ten times that in an order between N = 901 and 1001. Some figures of the
# paper are so close to other digits: orders by 1e-6, L^inf at N = 301 by 3e-9. Rounding alone
# leaves 1.5e-18 N^2.
TIGHT_RTOL = 1e-10
