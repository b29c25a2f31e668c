"""Two shear bands of a run: where they are, φ, γ̇ and stresses of each (VOT sec. III C 2 and Appendix B).

Axes: k block of rows, m layer in y. Inside this file, lengths are in units of the height Ly of the cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from petscjam.base.errors import InputError
from petscjam.base.types import Array
from petscjam.md.fields import Layers, Profile, layers, profile
from petscjam.md.result import Run, blocked_error
from petscjam.md.state import State

SIGNS = np.array([[1.0], [-1.0], [1.0]])  # Σ is −P_xy
FEWEST = 8, 4  # layers and blocks
SKILL = 0.8  # least share of the variance of vx − γ̇y that the other blocks predict
CONTRAST, ERRORS = 2.0, 3.0  # least ratio of the strain rates, and least difference in standard errors
WIDTHS = 0.005, 0.2  # of an interface
TRIAL, SHARES = 0.05, np.linspace(0.05, 0.95, 19)  # width and shares of the first fit


@dataclass(frozen=True, eq=False)
class Values:
    """Numbers of two shear bands, in pairs (Bagnoldian, Newtonian), or their standard errors.

    Attributes
    ----------
    phi, rate : (2,)
        φ, and γ̇ in 1/τe, in the middle of each band.
    share, share_phi : (2,)
        Shares of the height, from the means over the cell: γ̇ = Σ share × rate, and φ = Σ share_phi × phi (f′ and f
        of VOT Appendix B).
    stresses : (2, 3)
        P_xx, Σ and P_yy in the middle of each band, in m/τe²; NaN if the run has no stresses by layer.
    width : float
        w of an interface, in ds: γ̇ varies as tanh(Δy/w).
    pressure, friction : float
        P in m/τe² and μ = Σ/P of the cell.
    """

    phi: Array
    rate: Array
    share: Array
    share_phi: Array
    stresses: Array
    width: float
    pressure: float
    friction: float


@dataclass(frozen=True, eq=False)
class Bands(Values):
    """Two shear bands of a run, Bagnoldian and Newtonian.

    Attributes
    ----------
    errors : Values
        Standard errors.
    middles : (K,)
        y of the middle of the Bagnoldian band in each block, in ds.
    skill : float
        Share of the variance of vx − γ̇y in the blocks that is predicted by the other blocks.
    profile : Profile
        Means over the blocks, moved in y until the Bagnoldian band is in the middle of the cell.
    fitted : (3, M)
        vx, γ̇ and φ of the fit at the layers of the profile.
    """

    errors: Values
    middles: Array
    skill: float
    profile: Profile
    fitted: Array


class NoBandsError(InputError):
    """A run does not have two shear bands, or they cannot be seen."""


class Shape(NamedTuple):
    """Middle and share of the faster band, and width of its interfaces."""

    middle: float
    share: float
    width: float

    def weight(self, s: Array | float) -> Array:
        """Return the weight of the faster band at ``s``, from 0 to 1; its mean is the share."""
        upper, lower = self._edges(s)
        return (np.tanh(upper) - np.tanh(lower)).sum(0) / 2

    def velocity(self, s: Array) -> Array:
        """Return the integral of weight − share over ``s``, with mean 0."""
        upper, lower = self._edges(s)
        rise = np.logaddexp(upper, -upper) - np.logaddexp(lower, -lower)  # of ln cosh
        z = self.width / 2 * rise.sum(0) - self.share * self._away(s)
        return z - z.mean()

    def _away(self, s: Array | float) -> Array:
        return (np.asarray(s) - self.middle + 0.5) % 1 - 0.5

    def _edges(self, s: Array | float) -> tuple[Array, Array]:
        """Return the distances from both edges in widths, in this cell and its two neighbours, (3, …)."""
        near = np.stack([self._away(s) + image for image in (-1, 0, 1)])
        return (near + self.share / 2) / self.width, (near - self.share / 2) / self.width


def bands(run: Run, after: float | None = None) -> Bands:
    """Return the two shear bands of a run.

    In each block of the run, vx(y) is fitted by two bands with interfaces γ̇ ~ tanh(Δy/w), periodic up to the mean
    shear. The blocks are moved in y until the Bagnoldian band is in the middle of the cell, and summed. A fit to
    their mean profile vx(y) gives γ̇ and w; a fit to φ(y) with the same w gives φ; stresses are from a linear
    regression on the fitted γ̇(y). Errors are jackknife errors over blocks, those of pressure and friction as in
    :meth:`petscjam.md.result.Run.mean`.

    There are two bands if the other blocks predict at least 80 % of the variance of vx − γ̇y in a block, with the
    band at its mean position in the blocks before and after, and if γ̇ is at least twice as large, and φ lower, in
    one of them, by three standard errors.

    Parameters
    ----------
    run : Run
    after : float
        Strain to leave out at the start; default: a quarter of the run.

    Raises
    ------
    NoBandsError
        If the flow is homogeneous, its rate changes, or there are fewer than 8 layers or 4 blocks.
    """
    rates = run.rate[run.after(after)]
    if not rates.any() or np.ptp(rates) > 1e-9 * np.abs(rates).max():
        raise NoBandsError("bands: the strain rate is zero or changes")
    blocks, cell = layers(run, after), Cell(run.state, float(rates.mean()))
    count, M = blocks.disks.shape
    if M < FEWEST[0] or count < FEWEST[1] or not blocks.disks.all():
        raise NoBandsError(f"bands: {M} layers and {count} blocks; {FEWEST[0]} and {FEWEST[1]} are needed, with disks")
    u = np.array([cell.excess(some) for some in blocks.each])
    middles = np.array([_fit(x, _found(x)).middle % 1 for x in u])
    moved = blocks.moved(middles, cell.rise)
    mean = moved.total
    shape = _fit(cell.excess(mean), _found(cell.excess(mean)))
    if (skill := _skill(u, middles, shape, cell.excess(mean))) < SKILL:
        raise NoBandsError("bands: the flow is homogeneous: blocks of the run do not predict vx(y) of the others")
    found, fitted = _measured(mean, cell, shape)
    without = np.array([_measured(some, cell, shape)[0] for some in moved.without.each])
    pseudo = count * found - (count - 1) * without
    faster = (pseudo[:, 0] - CONTRAST * pseudo[:, 1]) / cell.rate
    for more, name in ((faster, "strain rate"), (pseudo[:, 3] - pseudo[:, 2], "φ")):
        if not more.mean() > ERRORS * blocked_error(more):
            raise NoBandsError(f"bands: the flow is homogeneous: there are not two bands by {name}")
    error = np.array([blocked_error(some) for some in pseudo.T])
    P, mu = run.mean("pressure", after), run.mean("friction", after)
    return Bands(
        **vars(_values(found, P.value, mu.value)),
        errors=_values(error, P.error, mu.error),
        middles=middles * run.state.height,
        skill=skill,
        profile=profile(run, after, middles),
        fitted=fitted,
    )


def _values(x: Array, pressure: float, friction: float) -> Values:
    return Values(x[2:4], x[:2], x[4:6], x[6:8], x[9:].reshape(2, 3), float(x[8]), pressure, friction)


class Cell(NamedTuple):
    """The state at the end of a run, and its mean strain rate in 1/τe."""

    state: State
    rate: float

    @property
    def rise(self) -> float:
        """Increase of vx from one image to the next, in ds/τe."""
        return self.rate * self.state.height

    def excess(self, some: Layers) -> Array:
        """Return (vx − γ̇y)/(γ̇Ly) by layer, with mean 0."""
        u = some.vx / some.disks / self.rise - _middles(some.disks)
        return u - u.mean()


def _middles(x: Array) -> Array:
    """Return the middles of layers in units of the height."""
    return (np.arange(len(x)) + 0.5) / len(x)


def _found(u: Array) -> Shape:
    """Return the best of some shapes at the middle of any layer."""
    s = _middles(u)
    trials = [Shape(s[0], share, TRIAL) for share in SHARES]
    z = np.array([trial.velocity(s) for trial in trials])
    overlap = np.fft.irfft(np.fft.rfft(u) * np.fft.rfft(z).conj(), len(u))  # trial, layer of its middle
    gain = np.maximum(overlap, 0) ** 2 / (z**2).sum(1, keepdims=True)
    k, m = np.unravel_index(np.argmax(gain), gain.shape)
    return trials[k]._replace(middle=s[m])


def _fit(u: Array, start: Shape) -> Shape:
    """Return the shape with the least-squares fit of its velocity, times any number, to ``u``."""
    from scipy.optimize import least_squares

    s, thin, u = _middles(u), 2 / len(u), u / (np.linalg.norm(u) or 1.0)

    def missed(p: Array) -> Array:
        z = Shape(*p).velocity(s)
        return z * _slope(z, u) - u

    low, high = (start.middle - 0.5, thin, WIDTHS[0]), (start.middle + 0.5, 1 - thin, WIDTHS[1])
    return Shape(*least_squares(missed, np.clip(start, low, high), bounds=(low, high), x_scale=TRIAL).x)


def _slope(x: Array, y: Array) -> float:
    """Return the slope of the linear regression of y on x, which has mean 0."""
    return float(x @ y / (x @ x))


def _measured(some: Layers, cell: Cell, start: Shape) -> tuple[Array, Array]:
    """Return the numbers of :func:`_values`, and vx, γ̇ and φ of the fit at the layers."""
    from scipy.optimize import minimize_scalar

    M, u = len(some.disks), cell.excess(some)
    s, shape = _middles(u), _fit(u, start)

    def regressed(x: Array, shape: Shape) -> tuple[Array, Array]:
        """Return the linear regression of x on the weight, in the middle of both bands and at the layers."""
        weight = shape.weight(s)
        slope = _slope(weight - weight.mean(), x)
        ends = shape.weight(shape.middle + np.array([0.0, 0.5]))
        return x.mean() + slope * (ends - weight.mean()), x.mean() + slope * (weight - weight.mean())

    def deviation(share: float) -> float:
        return float(((phi - regressed(phi, shape._replace(share=share))[1]) ** 2).sum())

    volume = some.samples * cell.state.length * cell.state.height / M
    phi, stress = some.area / volume, some.stress / volume * SIGNS
    share = minimize_scalar(deviation, bounds=(2 / M, 1 - 2 / M), method="bounded").x
    phis, fitted_phi = regressed(phi, shape._replace(share=share))
    z = shape.velocity(s)
    rise = _slope(z, u)
    weights = np.concatenate([shape.weight(shape.middle + np.array([0.0, 0.5])), shape.weight(s)])
    rates = cell.rate * (1 + rise * (weights - shape.share))
    shares = [(mean - x[1]) / (x[0] - x[1]) for mean, x in ((cell.rate, rates), (phi.mean(), phis))]
    pairs = [rates[:2], phis, *([f, 1 - f] for f in shares)]
    stresses = np.stack([regressed(x, shape)[0] for x in stress], axis=-1)
    vx = some.vx / some.disks + cell.rise * (rise * z - u)
    return np.concatenate([*pairs, [shape.width * cell.state.height], stresses.ravel()]), np.array(
        [vx, rates[2:], fitted_phi]
    )


def _skill(u: Array, middles: Array, shape: Shape, mean: Array) -> float:
    """Return the share of the variance of u (K, M) that is predicted by the mean shape.

    In each block the band is where it is, on average, in the block before and in the one after.
    """
    s, turns = _middles(mean), np.exp(2j * np.pi * middles)
    rise = _slope(shape.velocity(s), mean)
    near = np.pad(turns, 1)  # 0: no block
    expected = np.angle(near[:-2] + near[2:]) / (2 * np.pi)
    missed = [x - rise * shape._replace(middle=at).velocity(s) for x, at in zip(u, expected, strict=True)]
    return float(1 - np.square(missed).sum() / np.square(u).sum())
