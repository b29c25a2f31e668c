"""Types of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


def frozen(values: ArrayLike, dtype: type = np.float64) -> NDArray:
    """Return a read-only copy of ``values``."""
    array: NDArray = np.array(values, dtype=dtype)
    array.flags.writeable = False
    return array
