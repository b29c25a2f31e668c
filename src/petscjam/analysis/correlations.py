"""Correlations of non-affine displacements along x, at any frequency (BT Fig. 7).

    C(δ) = ⟨u_y(x) u_y(x + δ)⟩ / ⟨u_y²⟩

over pairs of backbone disks in the same lane, a narrow strip along x. u_y is that of Re Q* at peak stress and
of Im Q* at zero stress, Q* = (δσ/G*)(q, 1); C does not depend on δσ, and the affine motion of simple shear has no
y component.

Axes: i disk, f field, w frequency, d distance, l lane.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.analysis.statistics import standard_error
from petscjam.base import arguments, ranges
from petscjam.base.errors import InputError
from petscjam.base.progress import Progress, reporting
from petscjam.base.types import Array, Integers
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve
from petscjam.parallel.memory import require
from petscjam.response.origin import Judged, Verb, frequencies, stored
from petscjam.response.reduced import spectrum
from petscjam.response.spectrum import Spectrum
from petscjam.rows.damping import DampingLaw, with_law

FINEST = 1e-3  # of lanes and bins, mean diameters
ALONG = 1e-9  # largest y component of a lattice vector along x, relative to its length


class LaneCorrelation(NamedTuple):
    """Distances δ (D,) from 0 to L/2, C (…, D), NaN without pairs, and the number of pairs (D,)."""

    delta: Array
    C: Array
    pairs: Integers


class CorrelationLength(NamedTuple):
    """Over some packings: ω (W,), mean L, δ (D,), mean C (W, D), its zero l (W,), and the errors of l and of C."""

    omega: Array
    L: float
    delta: Array
    C: Array
    length: Array
    error: Array
    C_error: Array


@dataclass(frozen=True, eq=False)
class Correlations(Judged):
    """C(δ) of one packing in simple shear. Lengths are in the unit of the packing, time in τ1.

    Attributes
    ----------
    omega : (W,)
        Angular frequencies, 1/τ1.
    delta : (D,)
        Distances along x, multiples of the bin from 0 to half the cell.
    real, imaginary : (W, D)
        C at peak stress, Re Q*, and at zero stress, Im Q*; NaN without pairs.
    pairs : (D,)
        Number of pairs at each distance; pairs of a disk with itself do not count.
    G : (W,) complex
        G*(ω) of the reduced model.
    errors : (W,)
        Bound on its relative error; that of the displacements is about its square root.
    L : float
        Length of the cell along x.
    width, bin : float
        Largest height of a lane, and largest bin in δ.
    G0 : float
        Modulus at ω → 0.
    """

    omega: Array = field(metadata=stored("1/tau1", "W", finite=True))
    delta: Array = field(metadata=stored("length", "D", finite=True))
    real: Array = field(metadata=stored(axes="W D"))
    imaginary: Array = field(metadata=stored(axes="W D"))
    pairs: Integers = field(metadata=stored(axes="D"))
    G: NDArray[np.complex128] = field(metadata=stored(axes="W", finite=True))
    errors: Array = field(metadata=stored(axes="W"))
    L: float = field(metadata=stored("length", finite=True))
    width: float = field(metadata=stored("length", finite=True))
    bin: float = field(metadata=stored("length", finite=True))
    G0: float = field(metadata=stored("stress"))
    settings: ClassVar[tuple[str, ...]] = ("damping",)
    lines: ClassVar[str] = "W D"
    units: ClassVar[str] = "lengths in d"
    figure: ClassVar[str] = "petscjam.plots.correlations:correlations_figure"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        low, high = (f"{self.length[k] / self.L:.4g}" for k in (np.argmin(self.omega), np.argmax(self.omega)))
        return {
            "law": str(self.damping),
            "lane": self.width,
            "l/L at low omega": low,
            "at high": high,
            "error": f"{self.errors.max():.0e}",
            "state": self.state,
        }

    @property
    def length(self) -> Array:
        """Correlation length l(ω), (W,): zero of C at peak stress; NaN if there is none."""
        return np.array([zero_crossing(self.delta, C) for C in self.real])


@reporting
@with_law
def correlations(
    packing: Packing,
    omegas: ArrayLike,
    *,
    damping: DampingLaw | str | None = None,
    prestress: bool = True,
    comm: Comm | None = None,
    width: float | None = None,
    bin: float | None = None,
    rtol: float = 1e-8,
    name: str = "packing",
    progress: Progress | None = None,
) -> Correlations:
    """Return C(δ) at peak and at zero stress, at every frequency from one reduced model.

    Parameters
    ----------
    packing : Packing
        One of its two lattice vectors is along x.
    omegas : array_like
        Angular frequencies > 0, 1/τ1.
    damping : DampingLaw
        Default: :class:`ContactDamping` with β = 1 and rotations.
    prestress : bool
        Keep the second term of BT eq. 4.
    comm : MPI communicator
        Default: COMM_SELF. The result is the same on every rank.
    width, bin : float
        Largest height of a lane, and largest bin in δ. Default: the mean diameter d, and d/2.
    rtol : float
        Of |ΔG*|/|G*|; the relative error of displacements is about √rtol.
    name : str
        Stored with the result.
    progress : callable
        Called on every rank with a fraction and a text.

    Raises
    ------
    InputError
        On an invalid frequency, width or bin, or a cell without a lattice vector along x.
    SolverError
        If a solve fails.
    """
    comm = resolve(comm)
    agree(comm, packing, omegas, damping, prestress, width, bin, rtol)
    omega = frequencies(omegas)
    width, bin = _or_default(packing, width, bin)
    _Lanes.of(packing, width, bin).require_memory(comm)  # before the solves
    model = spectrum(
        packing,
        (omega.min(), omega.max()),
        damping=damping,
        prestress=prestress,
        rtol=rtol,
        comm=comm,
        name=name,
        progress=progress,
    )
    return correlations_of(model, omega, width=width, bin=bin)


def correlations_of(
    model: Spectrum, omegas: ArrayLike, *, width: float | None = None, bin: float | None = None
) -> Correlations:
    """Return C(δ) as :func:`correlations` does, from a model with its motions, without a solve.

    Parameters
    ----------
    model : Spectrum
    omegas : array_like
        1/τ1, in the span of the model.
    width, bin : float, optional
        As in :func:`correlations`.

    Raises
    ------
    InputError
        As :func:`correlations`; if the model was made without ``displacements``.
    """
    omega = frequencies(omegas)
    Q = np.array([model.displacement(w)[:, 1] for w in omega]) / model(omega)[:, None]
    packing = model.geometry
    assert packing is not None  # displacement refuses a model without motions
    backbone = ContactNetwork.of(packing).backbone
    u = np.where(backbone, np.stack([Q.real, Q.imag]), np.nan)
    u -= np.nanmean(u, axis=-1, keepdims=True)
    width, bin = _or_default(packing, width, bin)
    delta, C, pairs = lane_correlation(packing, u, width=width, bin=bin)
    return Correlations(
        omega=omega,
        delta=delta,
        real=C[0],
        imaginary=C[1],
        pairs=pairs,
        G=model(omega),
        errors=model.error(omega),
        L=_Lanes.of(packing, width, bin).L,
        width=float(width),
        bin=float(bin),
        G0=model.G0,
        negative_modes=model.negative_modes,
        zero_modes=model.zero_modes,
        origin=model.origin,
        notes=model.notes,
    )


def lane_correlation(packing: Packing, values: ArrayLike, *, width: float, bin: float) -> LaneCorrelation:
    """Return ⟨u u′⟩/⟨u²⟩ over pairs in the same lane against their distance δ along x, periodic up to L/2.

    A whole number of lanes and bins fills the cell. Positions along x are rounded to the bins, and all pairs of a
    lane are summed by FFT, without pairs of a disk with itself. No mean is subtracted from ``values``.

    Parameters
    ----------
    packing : Packing
        One of its two lattice vectors is along x.
    values : array_like, shape (…, N)
        Fields u; a disk with NaN in one of them is left out of all.
    width, bin : float
        Largest height of a lane, and largest bin in δ.

    Raises
    ------
    InputError
        On values of a wrong shape, an invalid width or bin, no lattice vector along x.
    """
    u = np.asarray(values, dtype=float)
    if u.ndim == 0 or u.shape[-1] != len(packing):
        raise InputError(f"values: the last axis must have length {len(packing)}, not {u.shape}")
    lanes = _Lanes.of(packing, width, bin)
    lanes.require_memory()
    L, shape, lane, column = lanes
    fields = u.reshape(-1, len(packing))
    counted = np.isfinite(fields).all(0)
    place = (lane * shape[1] + column)[counted]

    def summed(u: Array) -> Array:
        """Return Σ u u′ over pairs of different disks in a lane, (D,)."""
        line = np.bincount(place, weights=u, minlength=shape[0] * shape[1]).reshape(shape)
        power = (abs(np.fft.rfft(line, axis=1)) ** 2).sum(0)
        total = np.fft.irfft(power, shape[1])[: shape[1] // 2 + 1]
        total[0] -= (u**2).sum()
        double = 2 * np.arange(len(total)) % shape[1] == 0  # pairs that are counted twice
        return np.where(double, total / 2, total)

    pairs = np.rint(summed(np.ones(counted.sum()))).astype(np.int64)
    sums = np.array([summed(f) for f in fields[:, counted]])
    with np.errstate(divide="ignore", invalid="ignore"):
        C = np.where(pairs > 0, sums / pairs, np.nan) / (fields[:, counted] ** 2).mean(1)[:, None]
    return LaneCorrelation(np.arange(len(pairs)) * L / shape[1], C.reshape(*u.shape[:-1], -1), pairs)


def zero_crossing(delta: ArrayLike, C: ArrayLike) -> float:
    """Return the first δ > 0 where C is zero, by linear interpolation; NaN if there is none.

    C(0) = 1. Bins without pairs are left out, and the bin at δ = 0, too, because its pairs are separated along y.

    Parameters
    ----------
    delta, C : (D,)
        Lengths in ascending order; C is NaN in a bin without pairs.
    """
    x, y = np.asarray(delta, dtype=float), np.asarray(C, dtype=float)
    known = np.isfinite(y) & (x > 0)
    x, y = np.append(0.0, x[known]), np.append(1.0, y[known])
    if not (y <= 0).any():
        return np.nan
    k = int(np.argmax(y <= 0))
    return float(x[k - 1] + (x[k] - x[k - 1]) * y[k - 1] / (y[k - 1] - y[k]))


def minimum(delta: ArrayLike, C: ArrayLike) -> tuple[float, float]:
    """Return δ and C at the minimum of C: at L/2 if C decreases everywhere.

    Parameters
    ----------
    delta, C : (D,)
    """
    k = int(np.nanargmin(C))
    return float(np.asarray(delta)[k]), float(np.asarray(C)[k])


def correlation_length(
    results: Mapping[str, Correlations], part: str = "real", *, unstable: bool = False
) -> CorrelationLength:
    """Return the zero of the mean of C over several packings, with its jackknife error.

    Their cells may differ slightly, so C is averaged at the same δ/L, and lengths are those of the mean cell.
    The errors are NaN for a single packing; that of C is the standard error of the mean.

    Parameters
    ----------
    results : mapping of str to Correlations
        Of the same size, pressure and law.
    part : str
        ``real`` (peak stress) or ``imaginary`` (zero stress).
    unstable : bool
        Whether to include unstable packings.

    Raises
    ------
    InputError
        If no packing is stable, or their frequencies differ.
    """
    if part not in ("real", "imaginary"):
        raise InputError(f"part: must be 'real' or 'imaginary', not {part!r}")
    stable = [c for c in results.values() if unstable or c.stable]
    if not stable or any(not np.array_equal(c.omega, stable[0].omega) for c in stable):
        raise InputError("correlations: a mean needs stable packings, and the same frequencies for all")
    n, L = len(stable), float(np.mean([c.L for c in stable]))
    delta = L / stable[0].L * stable[0].delta
    C = np.array([[_at(delta, L / c.L * c.delta, row) for row in getattr(c, part)] for c in stable])
    without = (C.sum(0) - C) / (n - 1) if n > 1 else np.full(C.shape, np.nan)
    left = np.array([[zero_crossing(delta, row) for row in one] for one in without])
    mean = C.mean(0)
    length = np.array([zero_crossing(delta, row) for row in mean])
    error = np.sqrt((n - 1) * left.var(0))
    return CorrelationLength(stable[0].omega, L, delta, mean, length, error, standard_error(C))


def _at(delta: Array, known: Array, C: Array) -> Array:
    """Return C at ``delta`` by linear interpolation between bins with pairs."""
    there = np.isfinite(C)
    return np.interp(delta, known[there], C[there])


def _or_default(packing: Packing, width: float | None, bin: float | None) -> tuple[float, float]:
    d = packing.mean_diameter
    return d if width is None else width, d / 2 if bin is None else bin


class _Lanes(NamedTuple):
    """A grid of lanes and bins over the cell, and the place of each disk (N,) in it."""

    L: float
    shape: tuple[int, int]
    lane: Integers
    column: Integers

    @classmethod
    def of(cls, packing: Packing, width: float, bin: float) -> _Lanes:
        cell = packing.box.cell
        x = int(np.argmin(abs(cell[:, 1])))
        if abs(cell[x, 1]) > ALONG * abs(cell[x, 0]):
            raise InputError(f"box: lanes need a lattice vector along x, and {cell.tolist()} has none")
        L, height = abs(float(cell[x, 0])), abs(float(cell[1 - x, 1]))
        for what, value, most in (("width", width, height), ("bin", bin, L / 2)):
            ranges.Range(FINEST * packing.mean_diameter, most).check(f"{what}:", value)
        lanes, bins = int(np.ceil(height / width)), int(np.ceil(L / bin))
        across = packing.box.fractional(packing.positions)[:, 1 - x]
        along = packing.positions[:, 0] - np.floor(across) * cell[1 - x, 0]
        lane = np.floor(across % 1 * lanes).astype(np.int64) % lanes
        return cls(L, (lanes, bins), lane, np.floor(along / L * bins).astype(np.int64) % bins)

    def require_memory(self, comm: Comm | None = None) -> None:
        """Raise an error if there is not enough memory for the lanes and bins."""
        lanes, bins = self.shape
        require(64.0 * lanes * bins, f"correlations: {lanes} lanes of {bins} bins", comm)


def _options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--omega",
        dest="omegas",
        type=arguments.Within(arguments.frequencies, ranges.OMEGA),
        default="1e-8:1e0:9",
        metavar="RANGE",
        help="angular frequencies in 1/tau1: A:B:N or a list A,B,… (default 1e-8:1e0:9)",
    )
    text = "height of a lane, in the length unit of the packing (default: a mean diameter)"
    parser.add_argument("--width", type=arguments.number, metavar="X", help=text)
    text = "step of the distance along x (default: half a mean diameter)"
    parser.add_argument("--bin", type=arguments.number, metavar="X", help=text)


VERB = Verb(correlations, "C(distance) at peak and at zero stress", _options)
