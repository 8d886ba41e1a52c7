"""Loops in C: over the rows of sparse matrices, and over constraints, without copies.

Neither PETSc nor NumPy has a Gauss-Seidel sweep within bounds, and NumPy takes a pass over all
arrays for each operation. The loops are compiled once on a machine, by the compiler that DOLFINx
uses for forms, and are kept beside the forms.
"""

import functools
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from dolfinx import jit
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_signorini.base.compiled import once
from dolfinx_signorini.base.libraries import library

INT = "int64_t" if np.dtype(PETSc.IntType).itemsize == 8 else "int32_t"
MATRIX = f"{INT} rows, const {INT} *starts, const {INT} *columns, const double *entries"
SWEEP = f"{MATRIX}, const double *rest, const double *lower, const double *upper, double *x"
OBSTACLES = (
    "int64_t count, const int32_t *dofs, const double *signs, const double *obstacle, "
    "const double *diagonal, const double *x"
)
CHANGES = f"{INT} *slots, {INT} *places, {INT} *owners, double *by"
KINDS = {"d": "double[]", "i": "int32_t[]", "l": "int64_t[]", "?": "uint8_t[]"}
DECLARED = f"""
void forward({SWEEP}, double *step);
void backward({SWEEP}, double *step);
void settle({SWEEP}, double *step, int count);
void largest({MATRIX}, const double *values, double *found);
int64_t changed({MATRIX}, const uint8_t *before, const uint8_t *now, int64_t count,
                const int32_t *dofs, double diagonal, double *result, {CHANGES});
int64_t carried({MATRIX}, int64_t count,
                const {INT} *those, const {INT} *owned, const double *change,
                const {INT} *first, const {INT} *parents, const double *weights,
                const {INT} *begin, const {INT} *numbers, double *product, {CHANGES});
void fill({MATRIX}, int64_t count, const int32_t *those, double value, double *result);
void counts({MATRIX}, int32_t *number);
void sizes({MATRIX}, double *sums);
int64_t units({MATRIX}, const int32_t *number, int32_t *found, int32_t *parents);
void natural({OBSTACLES}, const double *multiplier, double *residual, double *pressing);
void defects({OBSTACLES}, const double *multiplier, double *found);
void touches({OBSTACLES}, uint8_t *found);
int moves({OBSTACLES}, double *values);
int places({OBSTACLES}, const uint8_t *held, double *values);
"""
# `changed` and `carried` note each entry that changes once: `slots` says where, from 1 on.
# A step is taken by one row after the other: rest - A step is what the steps so far leave, and in
# the first two sweeps the rows that are still to come have the step zero.
SOURCE = f"""
#include <stdint.h>
static double moved({INT} i, double left, double diagonal,
                    const double *lower, const double *upper, double *x)
{{
  const double before = x[i];
  double value = diagonal > 0.0 ? before + left / diagonal : before;
  if (value < lower[i]) value = lower[i];
  if (value > upper[i]) value = upper[i];
  x[i] = value;
  return value - before;
}}
void forward({SWEEP}, double *step)
{{
  for ({INT} i = 0; i < rows; ++i) {{
    double left = rest[i], diagonal = 0.0;
    for ({INT} p = starts[i]; p < starts[i + 1] && columns[p] <= i; ++p) {{
      if (columns[p] == i) diagonal = entries[p];
      else left -= entries[p] * step[columns[p]];
    }}
    step[i] = moved(i, left, diagonal, lower, upper, x);
  }}
}}
void backward({SWEEP}, double *step)
{{
  for ({INT} i = rows - 1; i >= 0; --i) {{
    double left = rest[i], diagonal = 0.0;
    for ({INT} p = starts[i + 1] - 1; p >= starts[i] && columns[p] >= i; --p) {{
      if (columns[p] == i) diagonal = entries[p];
      else left -= entries[p] * step[columns[p]];
    }}
    step[i] = moved(i, left, diagonal, lower, upper, x);
  }}
}}
void settle({SWEEP}, double *step, int count)
{{
  for ({INT} i = 0; i < rows; ++i) step[i] = 0.0;
  for (int k = 0; k < 2 * count; ++k)
    for ({INT} j = 0; j < rows; ++j) {{
      const {INT} i = k % 2 ? rows - 1 - j : j;
      double left = rest[i], diagonal = 0.0;
      for ({INT} p = starts[i]; p < starts[i + 1]; ++p) {{
        if (columns[p] == i) diagonal = entries[p];
        left -= entries[p] * step[columns[p]];
      }}
      step[i] += moved(i, left, diagonal, lower, upper, x);
    }}
}}
void largest({MATRIX}, const double *values, double *found)
{{
  for ({INT} i = 0; i < rows; ++i)
    for ({INT} p = starts[i]; p < starts[i + 1]; ++p)
      if (entries[p] != 0.0 && values[i] > found[columns[p]]) found[columns[p]] = values[i];
}}
static int64_t noted({INT} place, {INT} row, double change, int64_t count, {CHANGES})
{{
  if (!slots[place]) {{
    places[count] = place;
    owners[count] = row;
    by[count] = 0.0;
    slots[place] = ({INT})++count;
  }}
  by[slots[place] - 1] += change;
  return count;
}}
int64_t changed({MATRIX}, const uint8_t *before, const uint8_t *now, int64_t count,
                const int32_t *dofs, double diagonal, double *result, {CHANGES})
{{
  int64_t found = 0;
  for (int64_t c = 0; c < count; ++c)
    for ({INT} p = starts[dofs[c]]; p < starts[dofs[c] + 1]; ++p) {{
      const {INT} i = dofs[c], j = columns[p];
      const int was = !before[i] && !before[j], is = !now[i] && !now[j];
      {INT} q = starts[j];
      result[p] = is ? entries[p] : (i == j ? diagonal : 0.0);
      if (was != is) found = noted(p, i, (is - was) * entries[p], found, slots, places, owners, by);
      if (before[j] != now[j]) continue;
      while (columns[q] != i) ++q;
      result[q] = is ? entries[q] : 0.0;
      if (was != is) found = noted(q, j, (is - was) * entries[q], found, slots, places, owners, by);
    }}
  return found;
}}
int64_t carried({MATRIX}, int64_t count,
                const {INT} *those, const {INT} *owned, const double *change,
                const {INT} *first, const {INT} *parents, const double *weights,
                const {INT} *begin, const {INT} *numbers, double *product, {CHANGES})
{{
  int64_t found = 0;
  for (int64_t c = 0; c < count; ++c) {{
    const {INT} i = owned[c], j = columns[those[c]];
    for ({INT} k = first[i]; k < first[i + 1]; ++k)
      for ({INT} l = first[j]; l < first[j + 1]; ++l) {{
        const double more = weights[k] * change[c] * weights[l];
        {INT} place = begin[parents[k]];
        while (numbers[place] != parents[l]) ++place;
        product[place] += more;
        found = noted(place, parents[k], more, found, slots, places, owners, by);
      }}
  }}
  return found;
}}
void fill({MATRIX}, int64_t count, const int32_t *those, double value, double *result)
{{
  for (int64_t c = 0; c < count; ++c)
    for ({INT} p = starts[those[c]]; p < starts[those[c] + 1]; ++p)
      if (columns[p] == those[c]) result[p] = value;
}}
void counts({MATRIX}, int32_t *number)
{{
  for ({INT} i = 0; i < rows; ++i) number[i] += (int32_t)(starts[i + 1] - starts[i]);
}}
void sizes({MATRIX}, double *sums)
{{
  for ({INT} i = 0; i < rows; ++i)
    for ({INT} p = starts[i]; p < starts[i + 1]; ++p)
      sums[i] += entries[p] < 0.0 ? -entries[p] : entries[p];
}}
int64_t units({MATRIX}, const int32_t *number, int32_t *found, int32_t *parents)
{{
  int64_t count = 0;
  for ({INT} i = 0; i < rows; ++i) {{
    const {INT} p = starts[i];
    if (number[i] == 1 && starts[i + 1] > p && entries[p] * entries[p] == 1.0) {{
      found[count] = (int32_t)i;
      parents[count++] = (int32_t)columns[p];
    }}
  }}
  return count;
}}
void natural({OBSTACLES}, const double *multiplier, double *residual, double *pressing)
{{
  for (int64_t c = 0; c < count; ++c) {{
    const int32_t i = dofs[c];
    const double gap = diagonal[c] * signs[c] * (x[i] - obstacle[c]);
    const double pressure = signs[c] * multiplier[i];
    if (gap < signs[c] * residual[i]) residual[i] = signs[c] * gap;
    pressing[c] = pressure > gap ? pressure : 0.0;
  }}
}}
void defects({OBSTACLES}, const double *multiplier, double *found)
{{
  for (int64_t c = 0; c < count; ++c)
    found[c] = signs[c] * multiplier[dofs[c]] - diagonal[c] * signs[c] * (x[dofs[c]] - obstacle[c]);
}}
void touches({OBSTACLES}, uint8_t *found)
{{
  for (int64_t c = 0; c < count; ++c)
    found[c] = signs[c] * x[dofs[c]] <= signs[c] * obstacle[c];
}}
int moves({OBSTACLES}, double *values)
{{
  int moved = 0;
  for (int64_t c = 0; c < count; ++c)
    if (signs[c] * values[dofs[c]] < signs[c] * obstacle[c]) {{
      values[dofs[c]] = obstacle[c];
      moved = 1;
    }}
  return moved;
}}
int places({OBSTACLES}, const uint8_t *held, double *values)
{{
  int moved = 0;
  for (int64_t c = 0; c < count; ++c)
    if (held[c] && values[dofs[c]] != obstacle[c]) {{
      values[dofs[c]] = obstacle[c];
      moved = 1;
    }}
  return moved;
}}
"""


def load(comm: MPI.Comm) -> Path:
    """Return the file of the loops, which are compiled unless they are at hand; collective.

    Raises:
        InputError: The loops could not be compiled.
    """

    def look_up() -> Path:
        options = jit.get_options()
        arguments = [*options["cffi_extra_compile_args"], "-O3"]
        return library(comm, SOURCE, lambda: SOURCE, arguments, options["cache_dir"])

    file: Path = once(comm, (SOURCE, "loops"), look_up)
    return file


@functools.cache
def loops() -> tuple[Any, Any]:
    """Return the declarations and the library of the loops."""
    declared = cffi.FFI()
    declared.cdef(DECLARED)
    return declared, declared.dlopen(str(load(MPI.COMM_SELF)))


def run(name: str, *given: Any) -> Any:
    """Run a loop on numbers and contiguous arrays, and return what the loop returns."""
    declared, compiled = loops()
    return getattr(compiled, name)(
        *(
            declared.from_buffer(KINDS[item.dtype.char], item)
            if isinstance(item, np.ndarray)
            else item
            for item in given
        )
    )
