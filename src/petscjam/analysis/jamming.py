"""Approach to jamming: excess contacts, and fits of φ and of powers of the pressure."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.base.errors import InputError
from petscjam.base.types import Array

# Window of the fit Z − Z_iso ~ p^(a/2): above this p^a·N² there are no finite-size effects, below this p^a (p in
# k) corrections to scaling are small.
BULK, DENSE = 100.0, 1.1e-2


class PowerLaw(NamedTuple):
    """y = prefactor · x^exponent, with standard errors."""

    exponent: float
    exponent_error: float
    prefactor: float
    prefactor_error: float


class JammingDensity(NamedTuple):
    """φ = phi_J + slope · p^a, with standard errors, fitted to points up to the pressure ``highest``."""

    phi_J: float
    phi_J_error: float
    slope: float
    slope_error: float
    highest: float


def excess_contacts(particles: ArrayLike, rattlers: ArrayLike, contacts: ArrayLike) -> Array:
    """Return Z − Z_iso of packings.

    A periodic packing of N′ = N − rattlers disks with a positive bulk modulus has at least d·N′ − d + 1
    contacts: in two dimensions Z_iso = 4 − 2/N′ (Goodrich, Liu and Nagel, Phys. Rev. Lett. 109, 095704, 2012).

    Parameters
    ----------
    particles, rattlers, contacts : (k,)
        The contacts are those of the backbone.

    Returns
    -------
    (k,)
        NaN if all disks are rattlers.
    """
    backbone = np.asarray(particles, dtype=float) - np.asarray(rattlers)
    backbone = np.where(backbone == 0, np.nan, backbone)
    return 2 * (np.asarray(contacts) - (2 * backbone - 1)) / backbone


def in_window(p: ArrayLike, particles: int, a: float) -> NDArray[np.bool_]:
    """Mark the pressures of the fit of Z − Z_iso: p^a·N² > 100, as in Goodrich et al. for a = 1, and p^a ≤ 0.01.

    Parameters
    ----------
    p : (m,)
        Pressures, k.
    particles : int
    a : float
        Exponent of φ − φJ ~ p^a.

    Returns
    -------
    (m,) bool
    """
    scaled = np.asarray(p, dtype=float) ** a
    return np.asarray((scaled * particles**2 > BULK) & (scaled < DENSE))


def fit_power(x: ArrayLike, y: ArrayLike, error: ArrayLike | None = None) -> PowerLaw:
    """Fit y = A·x^a: a straight line through log y against log x, weighted by the standard errors of y.

    If the scatter about the line is larger than the errors, these are scaled up, as by the Particle Data Group.
    Without ``error``, or if one is missing (NaN or 0), all log y have the same weight, and the errors of the fit
    come from the scatter; for two points they are then NaN.

    Parameters
    ----------
    x, y : (m,)
    error : (m,), optional
        Standard errors of y.

    Returns
    -------
    PowerLaw

    Raises
    ------
    InputError
        If there are fewer than two different x, or a value that is not positive.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if not ((x > 0) & (y > 0)).all():
        raise InputError("fit: a power law needs values above 0")
    relative = None if error is None else np.asarray(error, dtype=float) / y
    (a, log_A), (a_error, log_A_error) = _line(np.log(x), np.log(y), relative)
    A = float(np.exp(log_A))
    return PowerLaw(a, a_error, A, A * log_A_error)


def fit_phi_J(
    p: ArrayLike, phi: ArrayLike, error: ArrayLike | None = None, *, exponent: float = 1.0, decades: float = 1.5
) -> JammingDensity:
    """Fit φ = φJ + c·p^a with a given a, over the lowest ``decades`` of the pressures.

    If fewer than three pressures are within ``decades``, the lowest three are used, or all if there are fewer.

    Parameters
    ----------
    p : (m,)
        Pressures, k.
    phi : (m,)
        Packing fractions.
    error : (m,), optional
        Their standard errors, used as in :func:`fit_power`.
    exponent : float
        a = 1/(α − 1), where the force of a contact grows as the power α − 1 of the overlap.
    decades : float

    Returns
    -------
    JammingDensity

    Raises
    ------
    InputError
        If there are fewer than two different pressures, or one is not positive.
    """
    p, phi = np.asarray(p, dtype=float), np.asarray(phi, dtype=float)
    if not (p > 0).all():
        raise InputError("fit: the pressures must be above 0")
    rising = np.unique(p)
    # A measured pressure differs slightly from its target: include the end of the range.
    highest = max(rising[0] * 10**decades * 1.05, rising[:3][-1]) if len(p) else 0.0
    low = p <= highest
    sigma = None if error is None else np.asarray(error, dtype=float)[low]
    (c, phi_J), (c_error, phi_J_error) = _line(p[low] ** exponent, phi[low], sigma)
    return JammingDensity(phi_J, phi_J_error, c, c_error, float(p[low].max()))


def _line(x: Array, y: Array, error: Array | None) -> tuple[tuple[float, float], tuple[float, float]]:
    """Fit a straight line; return slope and intercept, and their standard errors."""
    if len(np.unique(x)) < 2:
        raise InputError(f"fit: a line needs two different points, not {len(np.unique(x))}")
    known = error is not None and bool((np.isfinite(error) & (error > 0)).all())
    weights = 1 / error if error is not None and known else np.ones(len(x))
    (slope, intercept), covariance = np.polyfit(x, y, 1, w=weights, cov="unscaled")
    free = len(x) - 2
    chi2 = float(((weights * (y - slope * x - intercept)) ** 2).sum())
    scale = chi2 / free if free else np.nan
    if known:
        scale = np.fmax(scale, 1.0)
    slope_error, intercept_error = np.sqrt(scale * covariance.diagonal())
    return (float(slope), float(intercept)), (float(slope_error), float(intercept_error))
