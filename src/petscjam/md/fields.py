"""Density and strain rate in space: local maps, profiles across the flow, and shear bands.

Axes: i disk, c pair, b block, m layer in y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from petscjam.base.errors import InputError, shown
from petscjam.base.types import Array
from petscjam.md.result import Run
from petscjam.md.state import State

RADIUS = 4.0  # ds, VOT sec. III C 2
FEWEST = 8  # layers, to find two bands


def local_maps(state: State, radius: float = RADIUS) -> tuple[Array, Array]:
    """Return packing fraction and strain rate around every disk (VOT sec. III C 2 and fig. 27).

    Both are averages over a circle around the centre of a disk. The packing fraction is the area of disks inside
    the circle, divided by the area of the circle; of a disk on its edge only the part inside counts. The strain
    rate is ∂vx/∂y of a least-squares fit of the velocity field v0 + G·(r − r0) to the disks with centres inside.
    Images across the boundary move with γ̇Ly.

    Parameters
    ----------
    state : State
    radius : float
        Of the circle, in ds; above the largest radius of a disk.

    Returns
    -------
    phi : (N,)
    rate : (N,)
        In 1/τe; NaN if fewer than three disks are inside.

    Raises
    ------
    InputError
        If ``radius`` is too small.
    """
    from petscjam.geometry.neighbours import pairs

    sizes, n = state.radii, len(state)
    if not radius > sizes.max():
        raise InputError(f"maps: the radius must be above that of a disk, {sizes.max():g}, not {shown(radius)}")
    first, second, r = pairs(state.box, state.positions, sizes, radius)  # more than overlap the circles
    i, j, r = np.append(first, second), np.append(second, first), np.concatenate([r, -r])
    distance = np.hypot(*r.T)
    area = np.pi * sizes**2 + np.bincount(i, _overlap(distance, radius, sizes[j]), n)

    inside = distance <= radius
    i, j, (x, y) = i[inside], j[inside], r[inside].T
    u = state.peculiar[:, 0]  # the same for all images of a disk
    du = u[j] - u[i]
    count = 1 + np.bincount(i, minlength=n)  # the disk itself is at 0 and does not contribute

    def covariance(a: Array, b: Array) -> Array:
        mean_ab = np.bincount(i, a * b, n) / count
        return mean_ab - np.bincount(i, a, n) * np.bincount(i, b, n) / count**2

    xx, xy, yy = covariance(x, x), covariance(x, y), covariance(y, y)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = (xx * covariance(y, du) - xy * covariance(x, du)) / (xx * yy - xy**2)
    return area / (np.pi * radius**2), state.rate + np.where(count < 3, np.nan, slope)


def _overlap(d: Array, R: float, r: Array) -> Array:
    """Return the common area of circles of radius ``R`` and ``r`` < ``R`` at distance ``d``."""
    with np.errstate(divide="ignore"):
        a = np.clip((d**2 + R**2 - r**2) / (2 * d * R), -1, 1)
        b = np.clip((d**2 + r**2 - R**2) / (2 * d * r), -1, 1)
    return R**2 * np.arccos(a) + r**2 * np.arccos(b) - d * R * np.sqrt(1 - a**2)


@dataclass(frozen=True, eq=False)
class Profile:
    """Averages over layers in y, along x and over time (VOT fig. 28).

    Attributes
    ----------
    y : (M,)
        Middle of each layer, in ds.
    vx, rate, phi : (M,)
        Mean velocity in ds/τe, its slope dvx/dy in 1/τe, and packing fraction.
    vx_error, rate_error, phi_error : (M,)
        Standard errors over the blocks of the run; NaN if there is one only.
    length : float
        Ly of the cell: the layers fill it.
    mean_rate, mean_phi : float
        Of the cell. vx increases by ``mean_rate`` Ly from one image to the next.
    """

    y: Array
    vx: Array
    rate: Array
    phi: Array
    vx_error: Array
    rate_error: Array
    phi_error: Array
    length: float
    mean_rate: float
    mean_phi: float


def blocks_after(run: Run, strain: float | None = None) -> NDArray[np.bool_]:
    """Mark the blocks that end after ``strain`` from the start.

    Parameters
    ----------
    run : Run
    strain : float, optional
        Default: a quarter of the run.

    Returns
    -------
    (B,) bool
    """
    last = np.abs(run.strain[:, None] - run.blocks["strain"]).argmin(0)  # row of each
    return run.after(strain)[last]


def profile(run: Run, after: float | None = None) -> Profile:
    """Return the profiles of a run, averaged over the blocks that end after a strain.

    The strain rate of a layer comes from the velocities of its two neighbours. Errors are jackknife errors over
    blocks.

    Parameters
    ----------
    run : Run
    after : float
        Strain to leave out at the start; default: a quarter of the run.

    Raises
    ------
    InputError
        If no block is left, or a layer never contains a disk.
    """
    kept = blocks_after(run, after)
    if not kept.any():
        raise InputError(f"profile: none of {len(kept)} blocks ends after a strain of {after}")
    samples, disks, vx, area = (
        run.blocks[key][kept].astype(float) for key in ("samples", "layer_disks", "layer_vx", "layer_area")
    )
    if not disks.sum(0).all():
        raise InputError(f"profile: layer {int(np.argmin(disks.sum(0)))} contains no disk")
    state, layers = run.state, disks.shape[1]
    thickness = state.height / layers
    rate = float(run.rate[run.after(after)].mean())

    def means(samples: Array, disks: Array, vx: Array, area: Array) -> Array:
        """Return vx, dvx/dy and φ, (3, …, M)."""
        v = vx / np.where(disks > 0, disks, np.nan)
        rise = np.roll(v, -1, axis=-1) - np.roll(v, 1, axis=-1)
        rise[..., [0, -1]] += rate * state.height
        return np.stack([v, rise / (2 * thickness), area / (samples[..., None] * state.length * thickness)])

    sums = (samples, disks, vx, area)
    values = means(*(x.sum(0) for x in sums))
    if (count := int(kept.sum())) > 1:
        without = means(*(x.sum(0) - x for x in sums))  # each block in turn
        errors = np.sqrt((count - 1) * without.var(axis=1))
    else:
        errors = np.full_like(values, np.nan)
    y = (np.arange(layers) + 0.5) * thickness
    (v, slope, phi), (v_error, slope_error, phi_error) = values, errors
    return Profile(y, v, slope, phi, v_error, slope_error, phi_error, state.height, rate, state.phi)


@dataclass(frozen=True, eq=False)
class Bands:
    """Two bands of uniform strain rate, the faster one first.

    Attributes
    ----------
    rates : (float, float)
        Strain rate of each, in 1/τe.
    shares : (float, float)
        Share of the cell; Σ share × rate is the mean rate.
    centres : (float, float)
        y of the middle of each, in ds.
    vx : (M,)
        Velocities of the fit at the layers of the profile, in ds/τe.
    one, two : float
        Rms deviation of the profile from one slope and from these two, in ds/τe. Two slopes always fit better
        than one, also for noise: there are bands only if ``two`` is much smaller than ``one``, and ``one`` much
        larger than the errors of the profile.
    """

    rates: tuple[float, float]
    shares: tuple[float, float]
    centres: tuple[float, float]
    vx: Array
    one: float
    two: float


def bands(profile: Profile) -> Bands:
    """Fit vx(y) with least squares by a continuous line of two slopes, periodic up to the mean shear.

    Raises
    ------
    InputError
        If the profile has fewer than eight layers.
    """
    from scipy.optimize import minimize

    s, L, layers = profile.y / profile.length, profile.length, len(profile.y)
    if layers < FEWEST:
        raise InputError(f"bands: a profile of {layers} layers is too coarse; at least {FEWEST} are needed")
    u = profile.vx - profile.mean_rate * profile.y
    u = u - u.mean()

    def fit(start: Array, share: Array) -> tuple[Array, Array]:
        """Return the best fit to u, (…, M), and the difference of its slopes times L, (…, 1)."""
        z = _zigzag(s, start, share)
        z = z - z.mean(-1, keepdims=True)
        rise = (z @ u)[..., None] / (z**2).sum(-1, keepdims=True)
        return rise * z, rise

    thinnest, grid = 2 / layers, min(layers, 64)
    starts, shares = np.arange(grid) / grid, np.linspace(thinnest, 1 - thinnest, grid)
    coarse = ((u - fit(starts[:, None, None], shares[:, None])[0]) ** 2).sum(-1)
    a, b = np.unravel_index(np.argmin(coarse), coarse.shape)
    simplex = np.array([starts[a], shares[b]]) + np.array([[0, 0], [1, 0], [0, 1]]) / grid
    scale = float(u @ u) or 1.0
    best = minimize(
        lambda p: float(((u - fit(p[:1], p[1:])[0]) ** 2).sum()) / scale,
        simplex[0],
        method="Nelder-Mead",
        bounds=[(None, None), (thinnest, 1 - thinnest)],
        options={"xatol": 1e-7, "fatol": 1e-14, "initial_simplex": simplex},
    )
    start, share = best.x
    fitted, rise = fit(best.x[:1], best.x[1:])
    difference = float(rise[0]) / L
    inside = profile.mean_rate + difference * (1 - share), share, start + share / 2
    outside = profile.mean_rate - difference * share, 1 - share, start + (1 + share) / 2
    fast, slow = sorted([inside, outside], key=lambda band: -abs(band[0]))
    return Bands(
        rates=(float(fast[0]), float(slow[0])),
        shares=(float(fast[1]), float(slow[1])),
        centres=(float(fast[2] % 1 * L), float(slow[2] % 1 * L)),
        vx=profile.vx - u + fitted,
        one=float(u.std()),
        two=float((u - fitted).std()),
    )


def _zigzag(s: Array, start: Array | float, share: Array | float) -> Array:
    """Return the line of period 1 that rises by slope 1 − share over ``share`` from ``start``, and falls."""
    s = (s - start) % 1
    return np.minimum(s * (1 - share), share * (1 - s))
