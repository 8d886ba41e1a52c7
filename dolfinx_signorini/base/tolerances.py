"""Tolerances for rounding, derived from the precision of floating-point numbers.

Every comparison that must not depend on rounding uses one of these numbers, times the size of what
is compared.
"""

import math

import numpy as np

PRECISION = float(np.finfo(np.float64).eps)
# Sums of some thousand terms, and coordinates after a few operations: 9e-13.
ROUNDING = 2.0**12 * PRECISION
# Solutions of small linear systems, points carried to reference cells, Newton's method: 9e-10.
SOLVED = 2.0**22 * PRECISION
# Iterative solutions, linear programs, meshes and data written with seven digits: 1e-6.
SIX_DIGITS = 2.0**32 * PRECISION
# The half of a double's digits, 1e-8: so flat is a smooth function next to a maximum.
HALF_OF_THE_DIGITS = PRECISION**0.5
# Halvings after which nothing is left of a double: what gains a bit in each step needs no more.
HALVINGS = int(np.finfo(np.float64).nmant)
# The least number of which a product with PRECISION keeps all digits, 1e-292: in place of 0 where
# a quotient or a logarithm follows. Beyond TINY and 1 / TINY products lose digits or overflow.
TINY = float(np.finfo(np.float64).tiny) / PRECISION
FAR = 1.0 / TINY  # how far away from 0 a bound is that is none
# One operation, or one function of a library, which is at most 4 units in the last place off.
UNIT = 8.0 * PRECISION
UPWARDS = 1.0 + SOLVED  # times a bound that has been calculated: more than the bound


def power_of_two(value: float) -> float:
    """Return the power of two next below a number, 1/2 for zero: a division by it is exact."""
    return math.ldexp(0.5, math.frexp(value)[1])
