"""Types of arrays, and grids."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


def per_decade(points: int, low: float, high: float) -> Array:
    """Return a grid even in the logarithm, both ends included.

    Parameters
    ----------
    points : int
        Smallest number of steps per decade.
    low, high : float
        0 < low ≤ high.

    Returns
    -------
    (W,)
    """
    return np.geomspace(low, high, 1 + int(np.ceil(points * (np.log10(high) - np.log10(low)))))


def frozen(values: ArrayLike, dtype: type = np.float64) -> NDArray[Any]:
    """Return a read-only copy of ``values``.

    Parameters
    ----------
    values : array_like
    dtype : type
    """
    array: NDArray[Any] = np.array(values, dtype=dtype)
    array.flags.writeable = False
    return array
