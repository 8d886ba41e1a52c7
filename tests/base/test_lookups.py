"""Values of items that other ranks own."""

import numpy as np
import pytest

from dolfinx_signorini.base.lookups import Lookup


def shares(comm):
    """How many items each rank owns: the first one none, the others more and more."""
    return [0 if comm.size > 1 and r == 0 else 5 + 3 * r for r in range(comm.size)]


def asked(comm, count):
    """Numbers in any order, some of them several times; the last rank asks for none."""
    if comm.size > 1 and comm.rank == comm.size - 1:
        return np.empty(0, dtype=np.int64)
    return np.random.default_rng(comm.rank).integers(sum(shares(comm)), size=count)


@pytest.mark.parametrize("shape", [(), (3,), (2, 2)])
@pytest.mark.parametrize("kind", [bool, np.int32, np.float64])
def test_rows_are_found_wherever_they_are_owned(comm, shape, kind):
    every = np.random.default_rng(9).integers(2, size=(sum(shares(comm)), *shape)).astype(kind)
    first = sum(shares(comm)[: comm.rank])
    numbers = asked(comm, 40)
    lookup = Lookup(comm, shares(comm)[comm.rank], numbers)
    found = lookup.of(every[first : first + lookup.count])
    assert found.dtype == every.dtype
    assert np.array_equal(found, every[numbers])


def test_what_is_sent_arrives_at_the_items_and_comes_back(comm):
    numbers = asked(comm, 30)
    lookup = Lookup(comm, shares(comm)[comm.rank], numbers)
    first = sum(shares(comm)[: comm.rank])
    assert np.array_equal(lookup.sent(numbers), first + lookup.items)
    assert np.array_equal(lookup.returned(lookup.sent(numbers)), numbers)
    times = np.bincount(lookup.items, minlength=lookup.count)
    every = np.bincount(np.concatenate(comm.allgather(numbers)), minlength=sum(shares(comm)))
    assert np.array_equal(times, every[first : first + lookup.count])


def test_a_lookup_goes_through_another_one(comm):
    one = Lookup(comm, shares(comm)[comm.rank], asked(comm, 20))
    count = comm.allreduce(len(one.numbers))
    steps = np.random.default_rng(50 + comm.rank).integers(count, size=7 * comm.rank + 3)
    both = one.through(Lookup(comm, len(one.numbers), steps))
    every = np.concatenate(comm.allgather(one.numbers))
    assert np.array_equal(both.numbers, every[steps])
