"""Types of arrays, and grids."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError, shown

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
LONGEST = 60  # characters of a value in a message


def numbers(what: str, values: ArrayLike) -> Array:
    """Return a number or a list of numbers as an array with one axis.

    Parameters
    ----------
    what : str
        Their name in the message.
    values : array_like

    Returns
    -------
    (n,)

    Raises
    ------
    InputError
        If they are text, or lists of different lengths.
    """
    try:
        array = np.asarray(values)
        if array.size and array.dtype.kind not in "iuf":
            raise ValueError
        array = array.astype(float)
    except ValueError:
        text = _cut(shown(values))
        raise InputError(f"{what}: needs a number, a list or an array of numbers, not {text}") from None
    return np.atleast_1d(array).ravel()


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


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

    Raises
    ------
    InputError
        If they are no numbers.
    """
    try:
        array: NDArray[Any] = np.array(values, dtype=dtype)
    except (TypeError, ValueError):
        raise InputError(f"an array of numbers is needed, not {_cut(shown(values))}") from None
    array.flags.writeable = False
    return array
