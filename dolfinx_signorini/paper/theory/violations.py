"""Contact sets that violate condition (A), given by approximations as the checker takes them."""

from dolfinx_signorini.paper.theory.contact_sets import ContactSet, given_contact_set

LENGTH = 4.0  # of the boundary of the unit square


def fat_cantor_set(levels: int) -> tuple[list[ContactSet], list[ContactSet]]:
    """Return a closed set without interior and of measure 1/2, approximated in levels.

    From [0, 1] the open middle parts of length 1/4, 1/16, ... are taken away, 2^(k-1) of length
    4^(-k) in step k. All of the set is its relative boundary.

    Returns:
        The approximations from inside, which have no interior, and those from outside.
    """
    intervals = [(0.0, 1.0)]
    outer = []
    for k in range(1, levels + 1):
        cut = 0.25**k
        intervals = [
            part
            for a, b in intervals
            for part in ((a, 0.5 * (a + b - cut)), (0.5 * (a + b + cut), b))
        ]
        outer.append(given_contact_set(intervals, LENGTH))
    ends = [(x, x) for interval in intervals for x in interval]
    return [given_contact_set(ends, LENGTH)] * levels, outer


def ever_more_intervals(levels: int) -> tuple[list[ContactSet], list[ContactSet]]:
    """Return intervals of half the length each time that accumulate at a point, in levels.

    Returns:
        The approximations from inside: the first intervals; and those from outside, which fill
        what is left about the point.
    """
    pieces = [(0.25**k, 2.0 * 0.25**k) for k in range(2 * levels)]
    inner = [given_contact_set(pieces[: 2 * k], LENGTH) for k in range(1, levels + 1)]
    outer = [
        given_contact_set([*pieces[: 2 * k], (0.0, pieces[2 * k - 1][0])], LENGTH)
        for k in range(1, levels + 1)
    ]
    return inner, outer
