"""Density and strain rate in space: local maps, and profiles across the flow.

Axes: i disk, c pair, k block, m layer in y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from petscjam.base.errors import InputError, shown
from petscjam.base.types import Array
from petscjam.md.result import Run
from petscjam.md.state import State

RADIUS = 4.0  # ds, VOT sec. III C 2


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


class Layers(NamedTuple):
    """Sums over layers in y, of each block (K), or of some of them.

    Attributes
    ----------
    samples : (K, 1)
        Times.
    disks, vx, area : (K, M)
        Disks, sum of vx in ds/τe, sum of their area in ds².
    stress : (K, 3, M)
        Sums of P_xx, P_xy, P_yy times the volume, in m ds²/τe²; NaN if they were not recorded.
    """

    samples: Array
    disks: Array
    vx: Array
    area: Array
    stress: Array

    @property
    def each(self) -> list[Layers]:
        """The sums of each block."""
        return [Layers(*some) for some in zip(*self, strict=True)]

    @property
    def total(self) -> Layers:
        """The sums over all blocks."""
        return Layers(*(x.sum(0) for x in self))

    @property
    def without(self) -> Layers:
        """The sums over all blocks but one, which is each in turn."""
        return Layers(*(x.sum(0) - x for x in self))

    def moved(self, y: Array, rise: float) -> Layers:
        """Return the sums of blocks that are moved until the layers at ``y`` are in the middle of the cell.

        Parameters
        ----------
        y : (K,)
            In units of the height.
        rise : float
            Increase γ̇Ly of vx from one image to the next.
        """
        M = self.disks.shape[-1]
        at = (np.arange(M) + np.rint(y * M - M / 2).astype(int)[:, None]) % M
        affine = rise * (np.arange(M) + 0.5) / M

        def taken(x: Array) -> Array:
            return np.take_along_axis(x, at, 1)

        disks, excess = taken(self.disks), taken(self.vx - affine * self.disks)
        stress = np.take_along_axis(self.stress, at[:, None], 2)
        return Layers(self.samples, disks, excess + affine * disks, taken(self.area), stress)


def layers(run: Run, after: float | None = None) -> Layers:
    """Return the sums over layers of the blocks that end after a strain.

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
    unknown = np.full((len(run.blocks["strain"]), 3, disks.shape[1]), np.nan)
    return Layers(samples[:, None], disks, vx, area, run.blocks.get("layer_stress", unknown)[kept])


def profile(run: Run, after: float | None = None, moved: Array | None = None) -> Profile:
    """Return the profiles of a run, averaged over the blocks that end after a strain.

    The strain rate of a layer comes from the velocities of its two neighbours. Errors are jackknife errors over
    blocks.

    Parameters
    ----------
    run : Run
    after : float
        Strain to leave out at the start; default: a quarter of the run.
    moved : (K,)
        y/Ly of the point of each block that is moved to the middle of the cell; default: blocks are not moved.

    Raises
    ------
    InputError
        If no block is left, or a layer never contains a disk.
    """
    sums, state, rate = layers(run, after), run.state, float(run.rate[run.after(after)].mean())
    if moved is not None:
        sums = sums.moved(moved, rate * state.height)
    count, M = sums.disks.shape
    thickness = state.height / M

    def means(some: Layers) -> Array:
        """Return vx, dvx/dy and φ, (3, …, M)."""
        v = some.vx / np.where(some.disks > 0, some.disks, np.nan)
        rise = np.roll(v, -1, axis=-1) - np.roll(v, 1, axis=-1)
        rise[..., [0, -1]] += rate * state.height
        return np.stack([v, rise / (2 * thickness), some.area / (some.samples * state.length * thickness)])

    values = means(sums.total)
    unknown = np.full_like(values, np.nan)
    errors = np.sqrt((count - 1) * means(sums.without).var(axis=1)) if count > 1 else unknown
    y = (np.arange(M) + 0.5) * thickness
    (v, slope, phi), (v_error, slope_error, phi_error) = values, errors
    return Profile(y, v, slope, phi, v_error, slope_error, phi_error, state.height, rate, state.phi)
