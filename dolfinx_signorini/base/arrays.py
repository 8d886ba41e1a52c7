"""Names of arrays in annotations, the same in the whole package."""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.int64]  # of rows of other arrays, and global numbers
LocalIndices: TypeAlias = npt.NDArray[np.int32]  # of dofs, cells and facets, as DOLFINx has them
Mask: TypeAlias = npt.NDArray[np.bool_]

BLOCK = 131_072  # rows of an array that are worked on at a time: little memory for NumPy
