"""Density of states D(ω), ω = √λ, of K_uu with unit masses, by the kernel polynomial method.

A. Weiße, G. Wellein, A. Alvermann, H. Fehske, Rev. Mod. Phys. 78, 275 (2006). With λ = Ω² sin²(θ/2) a mode of
frequency ω is at the angle θ = 2 arcsin(ω/Ω), and D is a Fourier series in θ (docs/howto/density.md).

Axes: w frequency, v random vector, m moment, c contact, i disk, x Cartesian.
"""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from petscjam.analysis.statistics import standard_error
from petscjam.base import ranges
from petscjam.base.arguments import Within, integer
from petscjam.base.errors import InputError, SolverError
from petscjam.base.interrupt import check
from petscjam.base.progress import Progress, reporting
from petscjam.base.types import Array
from petscjam.geometry.network import ContactNetwork
from petscjam.geometry.packing import Packing
from petscjam.parallel.comm import Comm, agree, resolve, total
from petscjam.parallel.memory import require
from petscjam.parallel.petsc import destroying, stage
from petscjam.response.matrices import assembled
from petscjam.response.origin import Result, Verb, stored
from petscjam.response.problem import LinearProblem, describe
from petscjam.rows.kinematics import displacements

if TYPE_CHECKING:
    from petsc4py.PETSc import Mat

ROUNDING = 1e-9  # tolerance of |⟨v, T_m v⟩| ≤ 1
WEIGHTINGS = 20  # iterations that improve the bound on λ
TABLE = 1 << 22  # cosines in memory at once
SMOOTH = 20.0  # modes under the kernel of a smooth D
WIDTHS = 4  # smallest ω/σ in the search for the onset of the plateau


class Plateau(NamedTuple):
    """Height of D on its plateau with its standard error, and the frequency ω* of the onset.

    ``onset`` is NaN if it is below four times the resolution at ω → 0.
    """

    height: float
    height_error: float
    onset: float


@dataclass(frozen=True, eq=False)
class DensityOfStates(Result):
    """D(ω) of one packing. Units: ω in √(k/m) (BT) or √(ke/m)/d (VOT), with unit masses; D in 1/ω.

    Attributes
    ----------
    omega : (W,)
        Frequencies, ascending.
    density : (W,)
        D, the fraction of modes per frequency, smoothed by the kernel: its integral over 0 … Ω is 1.
    error : (W,)
        Standard error of D over the random vectors.
    cumulative : (W,)
        The fraction of modes below ω, the integral of D.
    resolution : (W,)
        Standard deviation of the kernel, in ω.
    moments : (V, M)
        ⟨v, T_m(1 − 2K/Ω²) v⟩ of each vector v, |v| = 1.
    edge : float
        Ω, an upper bound on the frequencies of all modes.
    modes : int
        2n − 2 for n disks in the backbone.
    negative_modes : int or None
        0, or None if they could not be counted, with the reason in a note.
    """

    omega: Array = field(metadata=stored("(stress/mass)^1/2", "W", finite=True))
    density: Array = field(metadata=stored(axes="W", finite=True))
    error: Array = field(metadata=stored(axes="W"))
    cumulative: Array = field(metadata=stored(axes="W", finite=True))
    resolution: Array = field(metadata=stored(axes="W", finite=True))
    moments: Array = field(metadata=stored(axes="V M", finite=True))
    edge: float = field(metadata=stored("(stress/mass)^1/2", finite=True))
    modes: int
    negative_modes: int | None
    units: ClassVar[str] = "frequencies in (k/m)^½, densities in their inverse"
    figure: ClassVar[str] = "petscjam.plots.density:density_figure"

    def row(self) -> dict[str, float | str]:
        """Return its line of the table."""
        found = plateau(self)
        return {
            "moments": f"{self.moments.shape[1]}",
            "vectors": f"{self.moments.shape[0]}",
            "highest": self.edge,
            "plateau": found.height,
            "±": found.height_error,
            "onset": found.onset,
        }

    def at(self, omega: ArrayLike) -> DensityOfStates:
        """Return the same at other frequencies (W,), 0 ≤ ω < Ω.

        Raises
        ------
        InputError
            On a frequency outside this range.
        """
        return replace(self, **series(self.moments, self.edge, np.atleast_1d(np.asarray(omega, dtype=float))))


@reporting
def density_of_states(
    packing: Packing,
    *,
    moments: int = 1024,
    vectors: int = 16,
    seed: int = 1,
    prestress: bool = True,
    comm: Comm | None = None,
    name: str = "packing",
    progress: Progress | None = None,
) -> DensityOfStates:
    """Estimate D(ω) of K_uu on the backbone, without translations, by products of K with vectors.

    Parameters
    ----------
    moments : int
        M; the kernel has the width π√(Ω² − ω²)/(2M + 2).
    vectors : int
        Random vectors; the statistical error falls as 1/√(vectors × modes).
    seed : int
    packing, prestress, comm, name, progress
        As for :func:`petscjam.spectrum`.

    Returns
    -------
    DensityOfStates
        At 2M frequencies, evenly in θ, so that each peak is resolved.

    Raises
    ------
    InputError
        If K has negative modes, with fewer than two moments or vectors, or without a connected backbone.
    SolverError
        If an eigenvalue is outside 0 … Ω².
    """
    comm = resolve(comm)
    agree(comm, packing, moments, vectors, seed, prestress)
    ranges.MOMENTS.check("moments:", moments)
    ranges.VECTORS.check("vectors:", vectors)
    ranges.SEED.check("seed:", seed)
    require(24.0 * vectors * moments, f"density: {vectors} × {moments} moments", comm)
    problem = LinearProblem.elastic(packing, prestress, comm)
    if problem.negative_modes:
        raise InputError(
            f"packing: K has {problem.negative_modes} negative modes, and no ω = √λ; minimise further, or "
            "leave pre-stress out"
        )
    backbone = problem.backbone.backbone
    modes = int(2 * backbone.sum() - 2)
    if modes == 0:
        raise InputError("packing: one disk has only translations as modes")
    bound = highest(problem.backbone)
    dofs = problem.number(displacements(backbone))
    found = np.empty((vectors + vectors % 2, moments))
    with assembled(problem.K, problem.B, dofs, comm) as pencil:
        twice_X = pencil.combine(-4 / bound, 0)
        twice_X.shift(2)
        for v in range(0, vectors, 2):  # K is real: two real vectors are one complex vector
            check(comm)
            pair = start_vector(seed, v, backbone) + 1j * start_vector(seed, v + 1, backbone)
            found[v : v + 2] = chebyshev(twice_X, dofs.scatter(pair, comm.rank), moments, comm)
            if progress:
                done = min(v + 2, vectors)
                progress(done / vectors, f"{done} of {vectors} vectors")
    edge = float(np.sqrt(bound))
    return DensityOfStates(
        **series(found[:vectors], edge, frequency_grid(edge, moments)),
        moments=found[:vectors],
        edge=edge,
        modes=modes,
        negative_modes=problem.negative_modes,
        origin=describe(problem, name),
        notes=tuple(problem.notes),
    )


def highest(network: ContactNetwork) -> float:
    """Return an upper bound on the eigenvalues of K, a few per cent above the highest.

    For each contact k(n·u_j − n·u_i)² ≤ k(1 + x_j/x_i)(n·u_i)² + k(1 + x_i/x_j)(n·u_j)² with any x > 0, and
    pre-stress only reduces it. So no eigenvalue of K exceeds the largest eigenvalue of the 2×2 blocks Σ_c k(1 +
    x_j/x_i) nnᵀ of the disks; x is iterated until the blocks are nearly equal.
    """
    i, j = np.concatenate([network.i, network.j]), np.concatenate([network.j, network.i])
    k, (nx, ny) = np.tile(network.stiffness, 2), np.tile(network.normal, (2, 1)).T
    x, bound = np.ones(len(network.radii)), np.inf
    for _ in range(WEIGHTINGS):
        weight = k * (1 + x[j] / x[i])
        xx, xy, yy = (np.bincount(i, weight * part, len(x)) for part in (nx * nx, nx * ny, ny * ny))
        largest = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)
        bound = min(bound, float(largest.max()))
        x *= np.sqrt(np.where(largest > 0, largest, 1.0))
    return bound


def start_vector(seed: int, v: int, backbone: NDArray[np.bool_]) -> Array:
    """Return random ±1 on the backbone, minus the mean, normalised, as a field (N, 3).

    If all disks have the same value, a translation, the vector is drawn again.

    Parameters
    ----------
    seed : int
    v : int
        Number of the vector.
    backbone : (N,) bool

    Returns
    -------
    (N, 3)
    """
    generator = np.random.default_rng([seed, v])
    u: Array = np.ones((len(backbone), 2))
    while not np.ptp(u[backbone], axis=0).any():
        u = np.asarray(generator.choice([-1.0, 1.0], (len(backbone), 2)), dtype=float)
    return projected(u, backbone)


def projected(u: Array, backbone: NDArray[np.bool_]) -> Array:
    """Return ``u`` on the backbone without translations, normalised, as a field (N, 3).

    Parameters
    ----------
    u : (N, 2)
    backbone : (N,) bool
    """
    field = np.zeros((len(u), 3))
    field[backbone, :2] = u[backbone] - u[backbone].mean(0)
    return field / np.linalg.norm(field)


def chebyshev(twice_X: Mat, start: NDArray[np.complex128], count: int, comm: Comm) -> Array:
    """Return the moments ⟨v, T_m(X) v⟩, (2, count), of the real and the imaginary part of ``start``.

    With t_n = T_n(X)v the moments 2n and 2n − 1 come from ⟨t_n, t_n⟩ and ⟨t_n, t_{n−1}⟩. The sums over ranks are
    taken once, at the end.

    Parameters
    ----------
    twice_X : PETSc.Mat
        2X, X = 1 − 2K/Ω².
    start : (n,) complex
        Two real vectors of length 1, this rank's rows.
    count : int
        Number of moments.
    comm : MPI communicator

    Raises
    ------
    SolverError
        If X has an eigenvalue outside −1 … 1, because the moments then grow.
    """
    before, now = twice_X.createVecs()
    after = now.duplicate()

    def product(a: Any, b: Any) -> Array:
        return np.einsum("nv,nv->v", *(t.array.view(float).reshape(-1, 2) for t in (a, b)))

    products = np.empty((2 * (count // 2) + 1, 2))
    with destroying(before, now, after), stage("Chebyshev"):
        before.array[:] = start
        twice_X.mult(before, now)
        now.scale(0.5)
        products[0] = product(before, before)
        for n in range(1, count // 2 + 1):
            products[2 * n - 1 : 2 * n + 1] = product(now, before), product(now, now)
            twice_X.mult(now, after)
            after.axpy(-1.0, before)
            before, now, after = now, after, before
    moments = 2 * total(comm, products)
    moments[0::2] -= moments[0] / 2
    moments[1::2] -= moments[1] / 2
    if not np.abs(moments).max() <= 1 + ROUNDING:
        raise SolverError("the moments grow: K has a negative mode, or one above the bound")
    return moments[:count].T


def jackson(count: int) -> Array:
    """Return the weights g_m of Jackson's kernel, (count,) (Weiße et al. eq. 71)."""
    m, q = np.arange(count), np.pi / (count + 1)
    return ((count - m + 1) * np.cos(q * m) + np.sin(q * m) / np.tan(q)) / (count + 1)


def frequency_grid(edge: float, count: int) -> Array:
    """Return 2·``count`` frequencies, evenly in θ: half the width of the kernel apart.

    Parameters
    ----------
    edge : float
        The highest frequency √λ of K.
    count : int
        Chebyshev moments.

    Returns
    -------
    (2·count,)
    """
    return edge * np.sin(np.pi / 2 * (np.arange(2 * count) + 0.5) / (2 * count))


def angular(moments: Array, theta: Array) -> tuple[Array, Array]:
    """Return the density in θ and its integral from 0, (V, W), for each vector.

    Parameters
    ----------
    moments : (V, M)
    theta : (W,)

    Returns
    -------
    density, integral : (V, W)
    """
    V, M = moments.shape
    m, weighted = np.arange(1, M), 2 * (jackson(M) * moments)[:, 1:]
    density, integral = np.empty((V, len(theta))), np.empty((V, len(theta)))
    for part in np.array_split(np.arange(len(theta)), 1 + len(theta) * M // TABLE):
        angles = np.outer(m, theta[part])
        density[:, part] = (1 + weighted @ np.cos(angles)) / np.pi
        integral[:, part] = (theta[part] + weighted / m @ np.sin(angles)) / np.pi
    return density, integral


def series(moments: Array, edge: float, omega: Array) -> dict[str, Any]:
    """Return D, its error, integral and resolution at ``omega``.

    Parameters
    ----------
    moments : (V, M)
    edge : float
        Ω.
    omega : (W,)
    """
    outside = ~((omega >= 0) & (omega < edge))
    if outside.any():
        raise InputError(f"omega: must be ≥ 0 and < {edge:g}, not {omega[np.argmax(outside)]:g}")
    density, integral = angular(moments, 2 * np.arcsin(omega / edge))
    slope = np.sqrt(edge**2 - omega**2) / 2  # dω/dθ
    return {
        "omega": omega,
        "density": density.mean(0) / slope,
        "error": standard_error(density) / slope,
        "cumulative": integral.mean(0),
        "resolution": np.pi / (moments.shape[1] + 1) * slope,
    }


def widened(density: DensityOfStates, omega: Array, width: Array) -> tuple[Array, Array]:
    """Return D and its error with a wider kernel.

    Parameters
    ----------
    density : DensityOfStates
    omega, width : (W,)
        ``width`` is the standard deviation of the kernel; if the resolution is more, that.
    """
    moments, edge = density.moments, density.edge
    slope = np.sqrt(edge**2 - omega**2) / 2
    counts = np.clip(np.pi * slope / width - 1, 2, moments.shape[1]).astype(int)
    found = [series(moments[:, :M], edge, omega[w : w + 1]) for w, M in enumerate(counts)]
    D, error = np.array([(one["density"][0], one["error"][0]) for one in found]).T
    return D, error


def smoothed(densities: Sequence[DensityOfStates], omega: ArrayLike) -> tuple[Array, Array]:
    """Return the mean of D over packings, with a kernel wide enough to be smooth, and its standard error, (W,), (W,).

    The kernel has the standard deviation for which ``SMOOTH`` modes of all packings are within ± it on the plateau of
    D, but at most ω/4 and (Ω − ω)/4. The error is that of the mean over packings; of one packing, that over its
    random vectors.

    Parameters
    ----------
    densities : sequence of DensityOfStates
        Of packings of one size and pressure.
    omega : (W,)
        Below all edges Ω.
    """
    omega = np.asarray(omega, dtype=float)
    modes = sum(d.modes * plateau(d).height for d in densities)
    width = np.minimum(omega / WIDTHS, SMOOTH / (2 * modes))
    found = [widened(d, omega, np.minimum(width, (d.edge - omega) / WIDTHS)) for d in densities]
    mean = np.mean([D for D, _ in found], axis=0)
    return mean, standard_error([D for D, _ in found]) if len(found) > 1 else found[0][1]


def plateau(density: DensityOfStates) -> Plateau:
    """Return the height of the plateau of D, and the frequency ω* of its onset.

    The height h is the mean of D over Ω/6 ≤ ω ≤ Ω/3. ω* is the highest frequency below Ω/6 where D is h/2, D with
    a number of moments for which the kernel has the width ω/4 there; with more moments D shows single modes.
    """
    moments, edge = density.moments, density.edge
    low, high = edge / 6, edge / 3
    _, shares = angular(moments, 2 * np.arcsin(np.array([1 / 6, 1 / 3])))
    heights = (shares[:, 1] - shares[:, 0]) / (high - low)
    height, error = float(heights.mean()), float(standard_error(heights))
    omega = np.geomspace(WIDTHS * float(density.at(0.0).resolution[0]), low, 200)
    D, _ = widened(density, omega, omega / WIDTHS)
    below = np.flatnonzero(D < height / 2)
    if omega[0] > low or len(below) == 0 or below[-1] == len(D) - 1:
        return Plateau(height, error, np.nan)
    step = slice(below[-1], below[-1] + 2)
    return Plateau(height, error, float(np.interp(height / 2, D[step], omega[step])))


def _options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--moments",
        type=Within(integer, ranges.MOMENTS),
        default=1024,
        metavar="M",
        help="Chebyshev moments: the resolution in omega is about 4/M of (k/m)^1/2 (default 1024)",
    )
    count, seed = Within(integer, ranges.VECTORS), Within(integer, ranges.SEED)
    parser.add_argument("--vectors", type=count, default=16, metavar="V", help="random vectors (default 16)")
    parser.add_argument("--seed", type=seed, default=1, help="seed of the random vectors (default 1)")


VERB = Verb(density_of_states, "D(omega) with its error and resolution", _options)
