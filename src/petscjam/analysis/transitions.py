"""Transitions between Newtonian and Bagnoldian flow: where they are, with errors over seeds (VOT sec. III, Appendix A).

Axes: s seed, k value of the parameter x that is varied (Q or φ).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from petscjam.base.errors import InputError
from petscjam.base.types import Array

SAMPLES = 400  # of a bootstrap
JAMMING = 0.8433  # φJ of VOT


class Located(NamedTuple):
    """A transition and its standard error."""

    value: float
    error: float


class Divergence(NamedTuple):
    """Qc = Q0 + c (φJ − φ)^−x (VOT fig. 3), and standard errors."""

    Q0: Located
    c: Located
    x: Located

    def __call__(self, phi: ArrayLike) -> Array:
        """Return Qc at ``phi``."""
        return self.Q0.value + self.c.value * (JAMMING - np.asarray(phi)) ** -self.x.value


def bootstrap(find: Callable[..., float], *samples: ArrayLike) -> Located:
    """Return ``find(*samples)`` and its standard error over seeds.

    Parameters
    ----------
    find : callable
        Of arrays like ``samples``; NaN if there is no transition.
    *samples : (S, K)
        Seeds are drawn with replacement, the same of each array.

    Returns
    -------
    Located
        The error is NaN for one seed, or if fewer than half of the draws have a transition.
    """
    arrays = [np.asarray(some, dtype=float) for some in samples]
    count, random = len(arrays[0]), np.random.default_rng(0)
    draws = [random.integers(count, size=count) for _ in range(SAMPLES if count > 1 else 0)]
    found = np.array([find(*(some[draw] for some in arrays)) for draw in draws])
    found = found[np.isfinite(found)]
    return Located(find(*arrays), float(found.std(ddof=1)) if len(found) > SAMPLES / 2 else np.nan)


def crossing(x: ArrayLike, shares: ArrayLike) -> Located:
    """Return the x at which the share of strain in the Newtonian state is one half.

    Parameters
    ----------
    x : (K,)
        Positive, ascending; the share decreases with x. Between values ln x is interpolated linearly.
    shares : (S, K)

    Returns
    -------
    Located
        The error is at least that of a uniform distribution over the interval with the crossing. NaN without one.
    """
    x, shares = np.asarray(x, dtype=float), np.asarray(shares, dtype=float)

    def interval(mean: Array) -> int | None:
        below = np.flatnonzero((mean[:-1] >= 0.5) & (mean[1:] < 0.5))
        return int(below[-1]) if len(below) else None

    def find(values: Array) -> float:
        mean = values.mean(0)
        k = interval(mean)
        if k is None:
            return np.nan
        part = (mean[k] - 0.5) / (mean[k] - mean[k + 1])
        return float(x[k] * (x[k + 1] / x[k]) ** part)

    value, error = bootstrap(find, shares)
    k = interval(shares.mean(0))
    if k is None:
        return Located(np.nan, np.nan)
    return Located(value, float(np.hypot(np.nan_to_num(error), (x[k + 1] - x[k]) / 12**0.5)))


def midpoint(x: ArrayLike, values: ArrayLike) -> Located:
    """Return the midpoint of the sharpest fall of a positive quantity, as of P^el(Q) (VOT fig. 3).

    Parameters
    ----------
    x : (K,)
        Positive, ascending.
    values : (S, K)

    Returns
    -------
    Located
        The geometric mean of the two x between which the logarithm falls most; the error is at least that of a
        uniform distribution between them.
    """
    x = np.asarray(x, dtype=float)

    def steepest(some: Array) -> int:
        return int(np.diff(np.log(some).mean(0)).argmin())

    def find(some: Array) -> float:
        k = steepest(some)
        return float((x[k] * x[k + 1]) ** 0.5)

    value, error = bootstrap(find, values)
    k = steepest(np.asarray(values, dtype=float))
    return Located(value, float(np.hypot(np.nan_to_num(error), (x[k + 1] - x[k]) / 12**0.5)))


def onset(x: ArrayLike, differences: ArrayLike, *, noise: float = 0.1) -> Located:
    """Return where a difference of two strain rates becomes nonzero: the intersection of two lines (VOT figs. 32, 33).

    One line is zero. The other is fitted to the points from the last one below ``noise`` of the largest difference to
    the first one above one half of it.

    Parameters
    ----------
    x : (K,)
        In the direction in which the difference rises from zero, as Q descending or φ ascending.
    differences : (S, K)
        Z/γ̇ or Bp of the lower rate minus that of the higher rate.
    noise : float
        Differences below this part of the largest count as zero.

    Returns
    -------
    Located
        NaN if the difference does not rise, or is nonzero everywhere.
    """
    x = np.asarray(x, dtype=float)

    def find(values: Array) -> float:
        y = values.mean(0)
        high = y.max()
        zero = np.flatnonzero(y <= noise * high)
        if high <= 0 or not len(zero) or zero[-1] == len(y) - 1:
            return np.nan
        first = int(zero[-1])
        last = first + 1 + int(np.argmax(y[first + 1 :] >= 0.5 * high))
        slope, offset = np.polyfit(x[first : last + 1], y[first : last + 1], 1)
        return float(-offset / slope) if slope else np.nan

    return bootstrap(find, differences)


def divergence(phi: ArrayLike, Qc: ArrayLike, errors: ArrayLike) -> Divergence:
    """Fit Qc = Q0 + c (φJ − φ)^−x with φJ = :data:`JAMMING` (VOT fig. 3).

    Parameters
    ----------
    phi, Qc, errors : (K,)
        At least four; errors are standard errors.

    Raises
    ------
    InputError
        If there are fewer than four points, or no fit.
    """
    from scipy.optimize import curve_fit

    phi, Qc, errors = (np.asarray(some, dtype=float) for some in (phi, Qc, errors))
    if len(phi) < 4:
        raise InputError(f"divergence: {len(phi)} packing fractions; a fit of three numbers needs four")

    def law(phi: Array, Q0: float, c: float, x: float) -> Array:
        return Q0 + c * (JAMMING - phi) ** -x

    try:
        best, covariance = curve_fit(law, phi, Qc, (1.0, 1.0, 1.0), errors, absolute_sigma=True, maxfev=10000)
    except RuntimeError as error:
        raise InputError(f"divergence: {error}") from None
    return Divergence(*map(Located, best.tolist(), np.sqrt(np.diag(covariance)).tolist()))
