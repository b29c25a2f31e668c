"""Boundaries of the coexistence of Bagnoldian and Newtonian flow, where both states meet, and jumps in ramps of γ̇.

VOT secs. III C, III D. Axes: s seed, k value of the parameter x that is varied (φ or ln γ̇).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from petscjam.analysis.transitions import Located, bootstrap
from petscjam.base.types import Array

STEEPER = 2.0  # least ratio of the slope between two kinks to those outside
ERRORS = 3.0  # least rise of μ, in standard errors
FINE = 4  # trial positions of a kink in an interval of x


class Boundaries(NamedTuple):
    """Boundaries of coexistence with homogeneous Bagnoldian flow (lower x) and Newtonian flow; NaN if not found."""

    bagnoldian: Located
    newtonian: Located


class Jump(NamedTuple):
    """The largest step of ln Σ(ln γ̇): strain rate in its middle in 1/τe, and its size in decades of Σ."""

    rate: float
    decades: float


def kinks(x: ArrayLike, values: ArrayLike) -> Boundaries:
    """Return the kinks of ln P^el(φ) (VOT fig. 22): breakpoints of the least-squares fit of three connected lines.

    Between the kinks the slope must be at least twice those outside: a smooth curve that bends upwards has none.

    Parameters
    ----------
    x : (K,)
        Ascending.
    values : (S, K)
        P^el, positive.

    Returns
    -------
    Boundaries
        NaN without kinks or for fewer than six x. An error is at least that of a uniform distribution over the
        spacing of x.
    """
    x, logs = np.asarray(x, dtype=float), np.log(values)
    if len(x) < 6:
        return _nothing()
    inner = np.arange(len(x) - 2)
    trials = np.interp(np.arange(0, inner[-1] + 1 / FINE, 1 / FINE), inner, x[1:-1])
    apart = 0.999 * np.diff(x).min()
    pairs = np.array([(a, b) for a in trials for b in trials if b - a >= apart])
    parts = [np.ones_like(x), x, *np.moveaxis(np.maximum(x - pairs[..., None], 0), 1, 0)]
    columns = np.stack(np.broadcast_arrays(*parts), axis=-1)  # of trial, x and part
    bases = np.linalg.qr(columns).Q

    def find(some: Array) -> tuple[float, float]:
        y = some.mean(0)
        best = int((np.einsum("pkc,k->pc", bases, y) ** 2).sum(1).argmax())
        _, first, second, third = np.linalg.lstsq(columns[best], y, rcond=None)[0]
        left, middle, right = np.cumsum([first, second, third])
        if middle <= 0 or middle < STEEPER * max(left, right):
            return np.nan, np.nan
        a, b = pairs[best]
        return float(a), float(b)

    return _bounded(x, find, logs)


def switches(x: ArrayLike, friction: ArrayLike, errors: ArrayLike) -> Boundaries:
    """Return where μ(φ) leaves the Bagnoldian branch and reaches the Newtonian one (VOT fig. 23).

    μ decreases with φ on both branches, and rises from one to the other: from a minimum to the maximum with the
    largest rise after it.

    Parameters
    ----------
    x : (K,)
        Ascending.
    friction : (S, K)
    errors : (K,)
        Standard errors of the means over seeds.

    Returns
    -------
    Boundaries
        NaN if the rise is less than three standard errors, or at the end of x. An error is at least that of a
        uniform distribution over the spacing of x.
    """
    x, errors = np.asarray(x, dtype=float), np.asarray(errors, dtype=float)

    def find(some: Array) -> tuple[float, float]:
        y = some.mean(0)
        rise = np.triu(y[None, :] - y[:, None], 1)
        i, j = np.unravel_index(int(rise.argmax()), rise.shape)
        if not rise[i, j] > ERRORS * np.hypot(errors[i], errors[j]):
            return np.nan, np.nan
        return (float(x[i]) if i > 0 else np.nan), (float(x[j]) if j < len(x) - 1 else np.nan)

    return _bounded(x, find, np.asarray(friction, dtype=float))


def jumps(x: ArrayLike, banding: ArrayLike, threshold: float) -> Boundaries:
    """Return where Rv rises above a threshold and where it falls below it again (VOT fig. 24).

    Parameters
    ----------
    x : (K,)
        Ascending.
    banding : (S, K)
        Rv, positive; geometric means over seeds are taken.
    threshold : float

    Returns
    -------
    Boundaries
        Middles of the intervals of x with a jump; NaN if Rv does not exceed the threshold, or does so at the end of
        x. An error is at least that of a uniform distribution over the spacing of x.
    """
    x = np.asarray(x, dtype=float)

    def find(some: Array) -> tuple[float, float]:
        above = np.flatnonzero(some.mean(0) > np.log(threshold))
        if not len(above):
            return np.nan, np.nan
        i, j = above[0], above[-1]
        rise = (x[i - 1] + x[i]) / 2 if i > 0 else np.nan
        return float(rise), float((x[j] + x[j + 1]) / 2 if j < len(x) - 1 else np.nan)

    return _bounded(x, find, np.log(banding))


def _bounded(x: Array, find: Callable[[Array], tuple[float, float]], samples: Array) -> Boundaries:
    """Return what is found, with errors over seeds and of the spacing of x."""

    def located(side: int) -> Located:
        value, error = bootstrap(lambda some: find(some)[side], samples)
        if np.isnan(value):
            return Located(np.nan, np.nan)
        k = int(np.clip(np.searchsorted(x, value), 1, len(x) - 1))
        return Located(value, float(np.hypot(np.nan_to_num(error), (x[k] - x[k - 1]) / 12**0.5)))

    return Boundaries(located(0), located(1))


def _nothing() -> Boundaries:
    return Boundaries(Located(np.nan, np.nan), Located(np.nan, np.nan))


def end_point(x: ArrayLike, gap: ArrayLike, errors: ArrayLike) -> Located:
    """Return the x at which two coexisting states become the same: their difference extrapolated to zero.

    The exponent of the difference is not known: it is extrapolated linearly (exponent 1), and so is its square
    (exponent ½, mean field). The value is the mean of both, and half of their difference is part of the error. The
    points from the largest difference on are fitted.

    Parameters
    ----------
    x : (K,)
        ln P or ln γ̇.
    gap, errors : (K,)
        φN* − φB* > 0 and standard errors.

    Returns
    -------
    Located
        NaN for fewer than three points, or if a difference does not decrease with x by two standard errors.
    """
    order = np.argsort(x)
    x, gap, errors = (np.asarray(some, dtype=float)[order] for some in (x, gap, errors))
    kept = slice(int(gap.argmax()) if len(gap) else 0, None)
    x, gap, errors = x[kept], gap[kept], errors[kept]
    if len(x) < 3:
        return Located(np.nan, np.nan)
    lines = [_zero(x, gap, errors), _zero(x, np.square(gap), 2 * gap * errors)]
    value, error = np.array(lines).T
    return Located(float(value.mean()), float(np.hypot(error.max(), (value[0] - value[1]) / 2)))


def _zero(x: Array, y: Array, errors: Array) -> Located:
    """Return the zero of a line with a negative slope, and its error."""
    middle = float(x.mean())
    (slope, offset), covariance = np.polyfit(x - middle, y, 1, w=1 / errors, cov="unscaled")
    if not slope < -2 * covariance[0, 0] ** 0.5:
        return Located(np.nan, np.nan)
    zero = -offset / slope
    direction = np.array([zero, 1.0])
    return Located(middle + float(zero), float((direction @ covariance @ direction) ** 0.5 / abs(slope)))


def jump(rate: ArrayLike, stress: ArrayLike, rows: int) -> Jump:
    """Return the largest step of ln Σ against ln γ̇ in one half of a ramp (VOT fig. 31).

    Both logarithms are averaged over ``rows`` consecutive rows; the step is that over as many rows.

    Parameters
    ----------
    rate, stress : (K,)
        Of rows in the order of the ramp, up or down; rows with Σ ≤ 0 are left out.
    rows : int
        At least 1.

    Returns
    -------
    Jump
        NaN if there are fewer than 3 × ``rows`` rows.
    """
    rate, stress = np.asarray(rate, dtype=float), np.asarray(stress, dtype=float)
    good = stress > 0
    if good.sum() < 3 * rows:
        return Jump(np.nan, np.nan)
    order = np.argsort(rate[good])
    x, y = (np.convolve(np.log(some[good][order]), np.full(rows, 1 / rows), "valid") for some in (rate, stress))
    step = y[rows:] - y[:-rows]
    k = int(step.argmax())
    return Jump(float(np.exp((x[k] + x[k + rows]) / 2)), float(step[k] / np.log(10)))


def loop(up: tuple[ArrayLike, ArrayLike], down: tuple[ArrayLike, ArrayLike]) -> float:
    """Return the area of the hysteresis of a ramp: decades of Σ times decades of γ̇, positive if Σ is higher downwards.

    Parameters
    ----------
    up, down : ((K,), (K,))
        γ̇ and Σ of rows of both halves, in any order; rows with Σ ≤ 0 are left out.

    Returns
    -------
    float
        NaN if a half has no row with Σ > 0.
    """
    halves = []
    for rate, stress in (up, down):
        x, y = np.asarray(rate, dtype=float), np.asarray(stress, dtype=float)
        order = np.argsort(x[y > 0])
        halves.append((np.log10(x[y > 0][order]), np.log10(y[y > 0][order])))
    if not all(len(x) for x, _ in halves):
        return np.nan
    low, high = max(x[0] for x, _ in halves), min(x[-1] for x, _ in halves)
    grid = np.linspace(low, high, 1001)
    rising, falling = (np.interp(grid, x, y) for x, y in halves)
    return float((falling - rising).mean() * (high - low))
