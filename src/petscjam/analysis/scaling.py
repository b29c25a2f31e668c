"""Exponents with errors: power laws, collapses of curves, local slopes (BT eqs. 14–22 and Fig. 8).

Errors come from a bootstrap over packings: docs/design/0013-collapse.md.

Axes: k packing, m point, c curve, q quantity (G′, G″), w point of a curve, e exponent, b resample.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize, minimize_scalar

from petscjam.base.errors import InputError, SolverError
from petscjam.base.types import Array

ESTIMATORS: dict[str, Callable[..., Any]] = {"mean": np.mean, "median": np.median}
PRIOR = 8  # packings: weight of the mean scatter of all points in that of one point
STEP, TOLERANCE = 0.1, 1e-4  # of an exponent: first step, and final accuracy of the search


@dataclass(frozen=True, eq=False)
class PowerFit:
    """y = prefactor · x^exponent.

    Attributes
    ----------
    exponent, error : float
        And its standard error.
    prefactor : float
    window : (float, float)
        The lowest and the highest x fitted.
    points : int
        Number of points.
    chi2 : float
        χ² per degree of freedom; NaN for two points.
    """

    exponent: float
    error: float
    prefactor: float
    window: tuple[float, float]
    points: int
    chi2: float


def power_law(
    x: ArrayLike,
    samples: Sequence[ArrayLike],
    window: tuple[float, float] | None = None,
    *,
    estimator: str = "mean",
    resamples: int = 2000,
    seed: int = 0,
) -> PowerFit:
    """Fit a straight line through ln(mean of y) against ln x.

    The error is the scatter of the slope if n − 1 of the n packings are drawn with replacement, independently at
    each x. It does not include a curvature: see ``chi2`` and :func:`local_exponents`. The weight of a point is
    the inverse of its variance. The mean relative scatter of all points enters this variance like ``PRIOR``
    additional packings, because the scatter of a few packings is inaccurate.

    Parameters
    ----------
    x : (m,) array_like
        For instance pressures.
    samples : m array_likes
        The values of the packings at each x. Some may be negative, but not the mean of a resample.
    window : (float, float)
        Fit x between these, both included. Default: all.
    estimator : str
        ``mean`` or ``median`` over packings.
    resamples, seed : int

    Raises
    ------
    InputError
        On fewer than two x in the window or two packings at one, packings with equal values, values that are not
        finite, an x or a mean that is not positive.
    """
    x, values = _within(np.asarray(x, dtype=float), samples, window)
    logs = np.stack(
        [_log_estimates(values[m], estimator, resamples, (seed, m), f"power law, x = {x[m]:g}") for m in range(len(x))]
    )
    n = np.array([len(packings) for packings in values])
    own = logs[:, 1:].var(axis=1)
    variance = ((n - 1) * own + PRIOR * (n * own).mean() / n) / (n - 1 + PRIOR)
    slopes, intercepts = np.polyfit(np.log(x), logs, 1, w=variance**-0.5)
    chi2 = ((logs[:, 0] - slopes[0] * np.log(x) - intercepts[0]) ** 2 / variance).sum()
    return PowerFit(
        exponent=float(slopes[0]),
        error=float(slopes[1:].std()),
        prefactor=float(np.exp(intercepts[0])),
        window=(float(x[0]), float(x[-1])),
        points=len(x),
        chi2=float(chi2 / (len(x) - 2)) if len(x) > 2 else np.nan,
    )


def _within(x: Array, samples: Sequence[ArrayLike], window: tuple[float, float] | None) -> tuple[Array, list[Array]]:
    """Return the x of the window, ascending, and their samples."""
    if x.ndim != 1 or len(x) != len(samples):
        raise InputError(f"power law: {x.size} x, but {len(samples)} sets of samples")
    _check_positive("power law: x", x)
    low, high = window if window else (x.min(initial=np.inf), x.max(initial=0.0))
    kept = [m for m in np.argsort(x) if low <= x[m] <= high]
    if len(np.unique(x[kept])) < 2:
        raise InputError(f"power law: {len(np.unique(x[kept]))} different x in {low:g} … {high:g}; it takes two")
    return x[kept], [np.asarray(samples[m], dtype=float) for m in kept]


def local_exponents(
    x: ArrayLike, samples: Sequence[ArrayLike], points: int = 3, **settings: Any
) -> tuple[PowerFit, ...]:
    """Fit power laws in windows of ``points`` neighbouring x, sliding by one, from low x to high.

    If they drift by more than their errors, one exponent for all x has a systematic error of this size.

    Parameters
    ----------
    x, samples
        As for :func:`power_law`.
    points : int
        Number of points of each window.
    **settings
        The other parameters of :func:`power_law`.

    Raises
    ------
    InputError
        As :func:`power_law`, and if there are fewer x than ``points``, or these are fewer than two.
    """
    rising = np.unique(np.asarray(x, dtype=float))
    if not 2 <= points <= len(rising):
        raise InputError(f"local exponents: windows of {points} points, of {len(rising)} different x")
    return tuple(
        power_law(x, samples, (rising[m], rising[m + points - 1]), **settings) for m in range(len(rising) - points + 1)
    )


def local_slope(f: Callable[[Array], Any], x: ArrayLike, step: float = 0.01) -> Array:
    """Return d ln f/d ln x at ``x`` (any shape) by central differences over ±``step`` in ln x.

    Their error is step²/6 of the third derivative. Of G″: ``local_slope(lambda w: spectrum(w).imag, omega)``.

    Parameters
    ----------
    f : callable
        Of an array.
    x : array_like
        Positive.
    step : float

    Raises
    ------
    InputError
        If an x or a value of f is not positive, or f is complex.
    """
    x = np.asarray(x, dtype=float)
    _check_positive("local slope: x", x)
    ends = [np.asarray(f(x * np.exp(sign * step))) for sign in (1, -1)]
    if np.iscomplexobj(ends[0]):
        raise InputError("local slope: f is complex; take its .real, its .imag or its modulus")
    for end in ends:
        _check_positive("local slope: f", end)
    return np.asarray(np.log(ends[0] / ends[1]) / (2 * step))


def log_slope(x: ArrayLike, y: ArrayLike) -> float:
    """Return d ln y/d ln x of the best straight line; NaN for fewer than two points.

    Parameters
    ----------
    x, y : (w,)
        Positive.
    """
    if len(np.asarray(x)) < 2:
        return np.nan
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve of a collapse: y at x for each packing of an ensemble.

    Attributes
    ----------
    x : (w,)
        Positive, in any order, all different.
    samples : (k, w) or (k, q, w)
        For each packing one quantity or several (G′ and G″), which then collapse with the same exponents.
    parameters : dict of float
        Parameters of the scaling form, for instance ``{"p": 1e-3}``.
    """

    x: ArrayLike
    samples: ArrayLike
    parameters: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Collapse:
    """Exponents of a collapse.

    Attributes
    ----------
    exponents, errors : dict of float
        By name, and their standard errors.
    quality : float
        S of :func:`quality`: about 1 if the curves agree within their errors, or less if the errors of a curve
        are correlated. If S is much larger, they do not agree.
    overlap : float
        See :func:`overlap`.
    resampled : (b, e)
        Exponents of each resample, in the order of the names: the error of a function of the exponents is
        the standard deviation of that function.
    """

    exponents: dict[str, float]
    errors: dict[str, float]
    quality: float
    overlap: float
    resampled: Array


def critical(mu: float, lam: float, *, p: float) -> tuple[float, float]:
    """Return X/x = p^−λ and Y/y = p^−μ: G* near jamming (BT eqs. 14–17). Between the plateaus G* ~ ω^Δ, Δ = μ/λ.

    Parameters
    ----------
    mu, lam : float
        Exponents.
    p : float
        Pressure, k.
    """
    return p**-lam, p**-mu


def finite_size(a: float, b: float = 2.0, *, N: float) -> tuple[float, float]:
    """Return X/x = N^b and Y/y = N^−a: η0 against p (BT Fig. 8). If η0 does not depend on N, y ~ x^(−a/b).

    Parameters
    ----------
    a, b : float
        Exponents.
    N : float
        Number of disks.
    """
    return N**b, N**-a


def log_corrected(c: float = 0.65, b: float = 0.5, *, p: float) -> tuple[float, float]:
    """Return X/x = p^−b and Y/y = (−ln p)^−c: the correlation length under Stokes drag (BT Fig. 7d).

    BT print l(−ln p)^0.65; lengths collapse with the opposite sign of the exponent.

    Parameters
    ----------
    c, b : float
        Exponents.
    p : float
        Pressure, k; below 1.
    """
    return p**-b, (-np.log(p)) ** -c


def parabola_distance(curves: Sequence[Curve], form: Callable[..., tuple[float, float]], **exponents: float) -> float:
    """Return the rms distance of ln Y from the best parabola in ln X, for the means over packings.

    It measures the collapse of curves that are too short to be compared with each other.

    Parameters
    ----------
    curves : sequence of Curve
        Of one quantity.
    form : callable
        As for :func:`collapse`.
    **exponents
        Of ``form``.
    """
    points = []
    for curve in curves:
        X, Y = form(**exponents, **curve.parameters)
        points.append(np.log([np.asarray(curve.x) * X, np.asarray(curve.samples).mean(0) * Y]))
    x, y = np.concatenate(points, axis=1)
    return float(np.sqrt(np.mean((y - np.polyval(np.polyfit(x, y, 2), x)) ** 2)))


def nearest_parabola(
    curves: Sequence[Curve],
    form: Callable[..., tuple[float, float]],
    name: str,
    bounds: tuple[float, float],
    resamples: int = 200,
) -> tuple[float, float]:
    """Find the exponent with the smallest :func:`parabola_distance`, and its standard error.

    The error is the scatter if n − 1 of the n packings of each curve are drawn with replacement.

    Parameters
    ----------
    curves, form
        As for :func:`parabola_distance`.
    name : str
        Of the exponent.
    bounds : (float, float)
        Range of the search.
    resamples : int

    Returns
    -------
    exponent, error : float
    """

    def best(drawn: Sequence[Curve]) -> float:
        def cost(value: float) -> float:
            return parabola_distance(drawn, form, **{name: value})

        return float(minimize_scalar(cost, bounds=bounds, method="bounded").x)

    generator = np.random.default_rng(0)
    found = []
    for _ in range(resamples):
        counts = [len(np.asarray(curve.samples)) for curve in curves]
        rows = [generator.integers(n, size=n - 1) for n in counts]
        drawn = [replace(curve, samples=np.asarray(curve.samples)[k]) for curve, k in zip(curves, rows, strict=True)]
        found.append(best(drawn))
    return best(curves), float(np.std(found))


def collapse(
    curves: Sequence[Curve],
    form: Callable[..., tuple[float, float]],
    start: Mapping[str, float],
    *,
    estimator: str = "mean",
    resamples: int = 200,
    seed: int = 0,
    least_overlap: float = 0.3,
) -> Collapse:
    """Find the exponents of the best collapse: the smallest :func:`quality` of ln Y against ln X.

    The search (Nelder and Mead) starts from ``start`` and finds a local minimum. It is repeated for each
    resample, in which n − 1 of the n packings of each curve are drawn with replacement. Whole packings are drawn,
    so correlations along a curve and between quantities are included; curves are assumed to be independent. The
    errors of the points are not resampled.

    Parameters
    ----------
    curves : sequence of Curve
        Only the data that should collapse: for instance without the affine regime.
    form : callable
        ``form(**exponents, **parameters)`` returns X/x and Y/y, like :func:`critical` or :func:`finite_size`.
    start : dict of float
        The exponents to be found, with their initial values. Others have the defaults of ``form``.
    estimator : str
        ``mean`` or ``median`` over packings.
    resamples, seed : int
    least_overlap : float
        Exponents with a smaller :func:`overlap` of the curves are not accepted.

    Raises
    ------
    InputError
        On fewer than two curves, different numbers of quantities, too little overlap at the start, an exponent or
        parameter that ``form`` does not have, and values as in :func:`power_law`.
    SolverError
        If the cost is smallest at the least overlap, that is without a collapse, or if the search does not converge.
    """
    if len(curves) < 2:
        raise InputError(f"collapse: {len(curves)} curves; it takes two")
    if not start:
        raise InputError("collapse: start names no exponent to find")
    search = _Search.of(curves, form, tuple(start), estimator, resamples, seed)
    first = np.array(list(start.values()), dtype=float)
    try:
        shared = overlap(search.scaled(first)[0])
    except TypeError as error:
        raise InputError(f"collapse: the form does not fit the exponents and parameters: {error}") from None
    if not shared >= least_overlap:
        raise InputError(
            f"collapse: at the start curves share {shared:.2g} of their length, less than "
            f"{least_overlap:g}: start elsewhere, or lower least_overlap"
        )
    fit = search.best(first, 0, least_overlap)
    shared = overlap(search.scaled(fit)[0])
    if shared < least_overlap + 0.02:
        raise SolverError(
            f"collapse: the curves agree best where they share only {shared:.2g} of their length: they do not collapse"
        )
    resampled = np.array([search.best(fit, b, least_overlap) for b in range(1, resamples + 1)])
    return Collapse(
        exponents=dict(zip(start, fit.tolist(), strict=True)),
        errors=dict(zip(start, resampled.std(axis=0).tolist(), strict=True)),
        quality=search.quality(fit, 0),
        overlap=shared,
        resampled=resampled,
    )


@dataclass(frozen=True, eq=False)
class _Search:
    """Curves in logarithms, and the search for the exponents: ln x (w,), ln y (1 + b, q, w) of each curve."""

    curves: Sequence[Curve]
    form: Callable[..., tuple[float, float]]
    names: tuple[str, ...]
    x: list[Array]
    logs: list[Array]
    variance: list[Array]
    covariance: list[Array]

    @classmethod
    def of(
        cls,
        curves: Sequence[Curve],
        form: Callable[..., tuple[float, float]],
        names: tuple[str, ...],
        estimator: str,
        resamples: int,
        seed: int,
    ) -> _Search:
        found = [
            _log_curve(curve, estimator, resamples, (seed, c), f"collapse, curve {c}") for c, curve in enumerate(curves)
        ]
        x, logs = [points for points, _ in found], [log_y for _, log_y in found]
        if len({log_y.shape[1] for log_y in logs}) > 1:
            raise InputError(f"collapse: curves have {sorted({log_y.shape[1] for log_y in logs})} quantities")
        spread = [log_y[1:] - log_y[1:].mean(axis=0) for log_y in logs]
        variance = [(off * off).mean(axis=0) for off in spread]
        covariance = [(off * np.roll(off, -1, axis=-1)).mean(axis=0) for off in spread]
        return cls(curves, form, names, x, logs, variance, covariance)

    def scaled(self, exponents: Array) -> tuple[list[Array], Array]:
        """Return ln X of each curve, and ln Y − ln y."""
        chosen = dict(zip(self.names, exponents, strict=True))
        factors = np.log([self.form(**chosen, **curve.parameters) for curve in self.curves])
        return [points + shift for points, shift in zip(self.x, factors[:, 0], strict=True)], factors[:, 1]

    def quality(self, exponents: Array, b: int) -> float:
        """Return S of resample ``b``; 0 is that of all packings."""
        X, shifts = self.scaled(exponents)
        Y = [log_y[b] + shift for log_y, shift in zip(self.logs, shifts, strict=True)]
        return quality(X, Y, self.variance, self.covariance)

    def best(self, begin: Array, b: int, least_overlap: float) -> Array:
        """Return the exponents of the smallest S, from ``begin``."""

        def cost(exponents: Array) -> float:
            return self.quality(exponents, b) if overlap(self.scaled(exponents)[0]) >= least_overlap else np.inf

        corners = begin + STEP * np.vstack([np.zeros(len(begin)), np.eye(len(begin))])
        found = minimize(
            cost,
            begin,
            method="Nelder-Mead",
            options={"initial_simplex": corners, "xatol": TOLERANCE, "fatol": np.inf, "maxfev": 500 * len(begin)},
        )
        if not found.success:
            raise SolverError(f"collapse: the search does not converge: {found.message}")
        return np.asarray(found.x)


def quality(x: Sequence[Array], y: Sequence[Array], variance: Sequence[Array], covariance: Sequence[Array]) -> float:
    """Return the mean squared distance between curves in units of squared standard errors: 1 if they agree.

    A variant of S of Houdayer and Hartmann, Phys. Rev. B 70, 014418 (2004). In a common range of x, each curve is
    compared with the weighted mean Y ± dY of the others, all interpolated linearly: S is the mean of (y −
    Y)²/(dy² + dY²) over quantities, curves and the length of the common range. A mean over points would jump when
    a point enters the common range, and a search would end there. dy and dY include the correlation of
    neighbouring points of a curve; without it S would oscillate with the grid.

    Parameters
    ----------
    x : c arrays (w,)
        Ascending.
    y, variance : c arrays (q, w)
    covariance : c arrays (q, w)
        Of each y with the next one; the last is not used.
    """
    edges = np.unique(np.concatenate(x))  # between these points every curve is straight or absent
    width, middle = np.diff(edges), (edges[:-1] + edges[1:]) / 2
    reaches, lines, squares = [], [], []
    for points, values, V, C in zip(x, y, variance, covariance, strict=True):
        b = np.clip(np.searchsorted(points, middle), 1, len(points) - 1)
        a = b - 1
        t = np.clip((middle - points[a]) / (points[b] - points[a]), 0, 1)
        s = 1 - t
        reaches.append((points[0] < middle) & (middle < points[-1]))
        lines.append(s * values[:, a] + t * values[:, b])
        squares.append(s * s * V[:, a] + 2 * s * t * C[:, a] + t * t * V[:, b])
    over, y_at, dy2 = np.array(reaches), np.array(lines), np.array(squares)  # (c, m), (c, q, m), (c, q, m)
    others = 1 - np.eye(len(x))
    shared = over & (others @ over > 0)
    weights = over[:, None] / dy2
    total = np.where(shared[:, None], np.tensordot(others, weights, 1), 1)
    mean = np.tensordot(others, weights * y_at, 1) / total
    S = ((y_at - mean) ** 2 / (dy2 + 1 / total)).mean(axis=1)
    return float((S * shared * width).sum() / (shared * width).sum())


def overlap(x: Sequence[Array]) -> float:
    """Return the smallest overlap of curves along x.

    For each curve except the first: the length of the common range with the curves that begin before it, divided
    by the shorter of the two lengths. Negative if there is a gap.
    """
    ends = np.array(sorted((points.min(), points.max()) for points in x))
    low, high = ends[1:].T
    reached = np.maximum.accumulate(ends[:, 1])[:-1]
    shorter = np.minimum(high - low, reached - ends[0, 0])
    return float(((np.minimum(reached, high) - low) / shorter).min())


def _log_curve(curve: Curve, estimator: str, resamples: int, seed: tuple[int, ...], where: str) -> tuple[Array, Array]:
    """Return ln x, ascending, and ln y (1 + b, q, w)."""
    x, samples = np.asarray(curve.x, dtype=float), np.asarray(curve.samples, dtype=float)
    if x.ndim != 1 or samples.ndim not in (2, 3) or samples.shape[-1] != len(x) or len(np.unique(x)) < 2:
        raise InputError(
            f"{where}: x {x.shape} and samples {samples.shape} are not (w,) and (k, w) or "
            "(k, q, w) with two different x"
        )
    if len(np.unique(x)) < len(x):
        raise InputError(f"{where}: the same x twice")
    _check_positive(f"{where}: x", x)
    rising = np.argsort(x)
    samples = samples.reshape(len(samples), -1, len(x))[..., rising]
    return np.log(x[rising]), _log_estimates(samples, estimator, resamples, seed, where)


def _log_estimates(samples: Array, estimator: str, resamples: int, seed: tuple[int, ...], where: str) -> Array:
    """Return the logarithm of the mean or median over packings, and of that of each resample, (1 + b, …)."""
    if estimator not in ESTIMATORS:
        raise InputError(f"estimator {estimator!r} is not one of {', '.join(ESTIMATORS)}")
    if resamples < 2:
        raise InputError(f"{resamples} resamples; errors need at least two, accurate ones hundreds")
    n = len(samples) if samples.ndim else 0
    if n < 2:
        raise InputError(f"{where}: {n} packings; an error needs two")
    if not np.isfinite(samples).all():
        raise InputError(f"{where}: a value is {samples[~np.isfinite(samples)][0]}")
    samples = samples[np.lexsort(samples.reshape(n, -1).T)]  # independent of the order of the packings
    draws = np.random.default_rng(seed).integers(n, size=(resamples, n - 1))
    of = ESTIMATORS[estimator]
    values = np.concatenate([of(samples, axis=0)[None], of(samples[draws], axis=1)])
    if not (values > 0).all():
        raise InputError(f"{where}: a {estimator} over packings is {values.min():g}, not above 0")
    if (np.ptp(values[1:], axis=0) <= 1e-13 * values[0]).any():
        raise InputError(f"{where}: {n} packings do not differ")
    return np.asarray(np.log(values))


def _check_positive(what: str, values: Array) -> None:
    good = np.isfinite(values) & (values > 0)
    if not good.all():
        raise InputError(f"{what} must be above 0, not {values[~good].flat[0]:g}")
